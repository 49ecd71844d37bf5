"""Phase portrait: shape rates against shapes, with the amended potential."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...analysis.full_reduction import Reduction
from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array
from ...common.errors import InputError, SymmetryError
from ...reduction.pointwise_reduction import symmetric
from ...simulation.trajectory import Trajectory
from ...system.state_fields import State, with_base
from ...system.system import System
from ..motion_source import MotionSource
from .fine_path import Path, charted_path, state_at
from .motion_labels import Labels, labels, moving_most, robot_of
from .shape_plane import Limits, Plane, around, draw_path, mark_start, plane, title_at
from .style import BLACK, BLUE, FIELD, RED, StyledFigure, figure, legend, line, styled

_LEVELS = 14  # number of level curves of the potential and of the energy
_TRIED = 50  # largest number of states of a recording whose energy is checked
_CLOSE = 1e-7  # largest relative difference of energies that count as equal
_FLAT = 1e-9  # largest relative change of constant values; also smallest scale of potentials [J]


@checks_arguments
@styled
def phase(
    motion: MotionSource,
    *,
    joints: Sequence[str | int] | None = None,
    limits: Limits | None = None,
    when: float = 0.0,
) -> Figure:
    """Draw shape rate against shape, with the amended potential V + ½ μᵀ I⁻¹ μ.

    With one joint, the potential is above the portrait; for a robot with one joint, the portrait
    has levels of the energy. With two joints, the path is drawn over the potential, next to a
    portrait of each joint.

    The momentum μ is about the centre of mass if the group translates. On SO3 and SE3 it rotates
    in the body frame, so the potential is valid at `when` only. Potentials of forces are included,
    torques are not. No potential is drawn for a pivot in gravity, or for a recording without its
    robot. The same holds for a recording whose energy includes forces, because a recording does not
    store them. Balls have unwrapped rotation vectors and their derivatives.

    Args:
        motion: Trajectory, or a recording read from a file.
        joints: Names or indices of one or two joints; the two that move most if None.
        limits: (low, high) of each joint [rad | m]; around the path if None.
        when: Time of the momentum and of the other joints [s]; a recording uses its nearest time.
    Returns:
        The figure.
    Raises:
        InputError: A robot without joints, or unknown names.
    """
    names = labels(motion)
    names.require(1, "a phase portrait")
    path = charted_path(motion)
    count = min(2, len(names.joints))
    selected = names.indices(moving_most(path.x, count) if joints is None else joints)
    if len(selected) > 2:
        raise InputError(f"joints: expected one or two for a phase portrait, got {len(selected)}")
    units = [names.units[k] for k in selected]
    if limits is None:
        limits = around(path.x[:, selected], units)
    system = robot_of(motion)
    reason = _why_no_potential(motion, system)
    landscape = None if system is None or reason else _Landscape(motion, system, when)
    at = path.x[0] if landscape is None else landscape.x
    shapes = plane(selected, limits, at)
    values = None if landscape is None else landscape.potential(shapes.shapes)
    title = f"{names.robot}: phase portrait" + (reason or _remark(names, landscape, values))
    frozen = title_at(names, selected, at)
    if frozen and values is not None:
        title += f"\n{frozen}"
    if len(selected) == 1:
        return _draw_one_joint(path, names, shapes, landscape, values, title)
    return _draw_two_joints(path, names, shapes, landscape, values, title)


class _Landscape:
    """Amended potential of a motion, for the momentum and the other joints at one time."""

    def __init__(self, motion: MotionSource, system: System, time: float) -> None:
        """Evaluate the momentum and the shape of the motion at a time."""
        state = with_base(state_at(motion, time), system.name)
        self._space = system.space
        self.x, self.time = self._space.chart(state.x[None])[0], float(state.t)
        self._forces = motion.scene.force_model if isinstance(motion, Trajectory) else None
        self._reduction = Reduction(system)
        group = system.group
        self.mu = np.zeros(group.dim)
        if group.turns:
            com = self._reduction.grid(state.x).com
            self.mu[group.linear :] = group.about(com, state.body_momentum)
        # A body momentum is constant if it has a single component, or if it is zero.
        self.is_exact = group.turns < 3 or not self.mu.any()
        self._xdot = state.xdot

    def _shapes(self, points: Array) -> Array:
        """Return the shapes, (…, nx), with the given coordinates, (…, m)."""
        space = self._space
        return space.integrate(space.neutral, points) if space.balls else points

    def potential(self, points: Array) -> Array | None:
        """Return V + ½ μᵀ I⁻¹ μ at points (…, m), or None if the motion has no such potential."""
        shapes = self._shapes(points)
        field = self._reduction.grid(shapes)
        try:
            values = np.array(field.amended_potential(self.mu))
        except SymmetryError:
            return None
        if self._forces is not None:
            flat = shapes.reshape(-1, shapes.shape[-1])
            extra = [self._forces.potential(x, self._forces.numbers) for x in flat]
            values += np.reshape(extra, values.shape)
        return values

    def metric(self, points: Array) -> Array:
        """Return the shape-space metric M at points (…, m), as (…, m, m)."""
        return self._reduction.grid(self._shapes(points)).reduced_metric

    def energy(self) -> float:
        """Return the energy ½ ẋᵀ M ẋ + V + ½ μᵀ I⁻¹ μ at the time of the landscape [J]."""
        values = self.potential(self.x[None])
        potential = 0.0 if values is None else float(values[0])
        return potential + 0.5 * float(self._xdot @ self.metric(self.x[None])[0] @ self._xdot)


def _why_no_potential(motion: MotionSource, system: System | None) -> str:
    """Return a remark for the title on why a recording has no potential; "" if it has one."""
    if isinstance(motion, Trajectory):
        return ""
    if system is None:
        return " (the robot of the file was not found: no potential)"
    if not isinstance(motion.outputs, State):
        return " (the file leaves out the base: no potential)"
    if not _is_all_energy(motion.outputs, system):
        return " (the file does not store its forces: no potential)"
    return ""


def _is_all_energy(states: State, system: System) -> bool:
    """Return whether the stored energy equals that of Pinocchio's model, and so excludes forces."""
    model, data = system.sorted_model, system.sorted_model.createData()
    q, v = system.sort_q(states.q), system.sort_v(states.v)
    differences, size = [], 0.0
    for k in np.linspace(0, len(states.t) - 1, _TRIED).astype(int):
        H = symmetric(pin.crba(model, data, q[k]))
        kinetic = 0.5 * float(v[k] @ H @ v[k])
        potential = float(pin.computePotentialEnergy(model, data, q[k]))
        differences.append(abs(states.energy[k] - kinetic - potential))
        size = max(size, kinetic + abs(potential))
    return bool(max(differences) <= _CLOSE * size)


def _remark(names: Labels, landscape: _Landscape | None, values: Array | None) -> str:
    if landscape is None or values is None:
        return f" (gravity rotates the base: no potential on the shape of {names.group} alone)"
    if _is_flat(values):
        return f" (the amended potential is {values.flat[0]:.4g} J everywhere)"
    return "" if landscape.is_exact else f", potential for μ of t = {landscape.time:g} s"


def _is_flat(values: Array) -> bool:
    return bool(np.ptp(values) <= _FLAT * max(_FLAT, float(np.abs(values).max())))


def _draw_one_joint(
    path: Path, names: Labels, shapes: Plane, landscape: _Landscape | None,
    values: Array | None, title: str,
) -> StyledFigure:  # fmt: skip
    (joint,), (x,) = shapes.joints, shapes.axes
    count = 1 if values is None else 2
    drawing = figure(title, height=0.7 + 2.1 * count + (0.6 if count == 2 else 0.0))
    panels = drawing.subplots(
        count, 1, sharex=True, squeeze=False,
        gridspec_kw={"height_ratios": [2, 3][-count:]},
    )[:, 0]  # fmt: skip
    portrait = panels[-1]
    if landscape is not None and values is not None:
        top = panels[0]
        top.plot(x, values, label="amended potential", **line(0))
        if len(names.joints) == 1 and landscape.is_exact:
            top.axhline(landscape.energy(), label="energy", color=RED, linestyle="--")
        top.set_ylabel("potential [J]")
        legend(top)
    _portrait(portrait, path, names, joint)
    portrait.set_xlim(x[0], x[-1])
    if landscape is not None and values is not None and len(names.joints) == 1:
        low, high = around(path.xdot[:, [joint]], ["rate"])[0]
        rate = np.linspace(low, high, len(x))
        energy = 0.5 * rate[:, None] ** 2 * landscape.metric(shapes.shapes)[:, 0, 0] + values
        portrait.contour(
            x, rate, energy, levels=_LEVELS, colors="#999999", linewidths=0.7, linestyles="-"
        )
        portrait.plot([], [], color="#999999", linewidth=0.7, label="levels of the energy")
        portrait.set_ylim(low, high)
    portrait.set_xlabel(names.with_unit(joint))
    legend(portrait)
    return drawing


def _draw_two_joints(
    path: Path, names: Labels, shapes: Plane, landscape: _Landscape | None,
    values: Array | None, title: str,
) -> StyledFigure:  # fmt: skip
    drawing = figure(title, width=9.6, height=4.6)
    grid = drawing.add_gridspec(2, 2, width_ratios=[3, 2])
    main = drawing.add_subplot(grid[:, 0])
    a, b = shapes.joints
    if landscape is not None and values is not None and not _is_flat(values):
        field = main.contourf(*shapes.axes, values, levels=_LEVELS, cmap=FIELD)
        main.contour(*shapes.axes, values, levels=_LEVELS, colors=BLACK, linewidths=0.3)
        bar = drawing.colorbar(field, ax=main, location="left", pad=0.02)
        bar.set_label("amended potential [J]")
        energy = landscape.energy()
        if len(names.joints) == 2 and landscape.is_exact and values.min() < energy < values.max():
            main.contour(*shapes.axes, values, levels=[energy], colors="white", linewidths=1.8)
            main.plot([], [], color="#BBBBBB", linewidth=1.8, label="potential = energy")
    draw_path(main, path.x[:, a], path.x[:, b])
    main.grid(visible=False)
    main.set(xlim=shapes.axes[0][[0, -1]], ylim=shapes.axes[1][[0, -1]])
    main.set(xlabel=names.with_unit(a), ylabel=names.with_unit(b))
    main.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, frameon=False)
    for panel, joint in enumerate((a, b)):
        axes = drawing.add_subplot(grid[panel, 1])
        _portrait(axes, path, names, joint)
        axes.set_xlabel(names.with_unit(joint))
    return drawing


def _portrait(axes: Axes, path: Path, names: Labels, joint: int) -> None:
    """Draw the rate of one joint against its angle or position."""
    unit = names.units[joint].replace(" | ", "/s | ")
    x, rate = path.x[:, joint], path.xdot[:, joint]
    axes.plot(x, rate, color=BLUE, linewidth=1.6, label="path", zorder=3)
    mark_start(axes, x, rate)
    axes.set_ylabel(f"rate [{unit}/s]")
