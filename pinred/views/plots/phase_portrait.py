"""The phase portrait of the shape, with the amended potential that governs it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...analysis.full_reduction import Reduction
from ...common.arrays import Array
from ...common.errors import InputError, SymmetryError
from ...reduction.inertia_split import symmetric
from ...simulation.trajectory import Trajectory
from ...system.state_fields import State, with_base
from ...system.system import System
from ..motion_source import MotionSource
from .fine_path import Path, fine_path, state_at
from .motion_labels import Labels, labels, robot_of
from .shape_plane import Limits, Plane, around, draw_path, plane, title_at
from .style import BLACK, BLUE, FIELD, RED, StyledFigure, figure, legend, line, styled
from .time_series import require_joints

_LEVELS = 14
_TRIED = 50  # states of a file whose energy is looked at
_CLOSE = 1e-7  # relative; energies that differ by less are the same
_FLAT = 1e-9  # relative, or J; a potential that changes by less is constant


@styled
def phase(
    motion: MotionSource,
    *,
    joints: Sequence[str | int] | None = None,
    limits: Limits | None = None,
    when: float = 0.0,
) -> Figure:
    """Draw shape against rate, with the amended potential V + ½ μᵀ I⁻¹ μ.

    One joint: the potential above, and below the portrait; if it is the only joint, on the
    levels of its energy.  Two joints: the path over the potential, and a portrait of each.
    joints: one or two names or indices, the first two if None.  limits: (low, high) of each
    joint.  when: the time at which the momentum and the joints that do not vary are taken [s].

    μ is the momentum about the centre of mass where the group translates.  On SO3 and SE3 it
    turns in the body, so that away from `when` the potential is another one.  Potentials of
    forces count, torques do not.  A pivot in gravity has no potential; nor has a file whose
    robot is not found, or whose energy has more in it than the robot's, as it holds no forces;
    of the others, `when` is the nearest time in it.
    Raises InputError for a robot without joints, or names that are not there.
    """
    names = labels(motion)
    require_joints(names, 1, "a phase portrait")
    chosen = names.indices(joints if joints is not None else range(min(2, len(names.joints))))
    if len(chosen) > 2:
        raise InputError(f"joints must be one or two for a phase portrait, got {len(chosen)}")
    units = [names.units[k] for k in chosen]
    path = fine_path(motion)
    if limits is None:
        limits = around(path.x[:, chosen], units)
    system = robot_of(motion)
    lack = _lack(motion, system)
    landscape = None if system is None or lack else _Landscape(motion, system, when)
    at = motion.x[0] if landscape is None else landscape.x
    shapes = plane(chosen, limits, at)
    values = None if landscape is None else landscape.potential(shapes.shapes)
    title = f"{names.robot}: phase portrait" + (lack or _remark(names, landscape, values))
    rest = title_at(names, chosen, at)
    if rest and values is not None:
        title += f"\n{rest}"
    if len(chosen) == 1:
        return _one(path, names, shapes, landscape, values, title)
    return _two(path, names, shapes, landscape, values, title)


class _Landscape:
    """The amended potential of a motion at one of its times."""

    def __init__(self, motion: MotionSource, system: System, time: float) -> None:
        """Take the momentum and the shape at a time."""
        state = with_base(state_at(motion, time), system.name)
        self.x, self.time = state.x, float(state.t)
        self._forces = motion.scene.force_model if isinstance(motion, Trajectory) else None
        self._reduction = Reduction(system)
        group = system.group
        self.mu = np.zeros(group.dim)
        if group.turns:
            com = self._reduction.grid(state.x).com
            self.mu[group.linear :] = group.about(com, state.body_momentum)
        # Constant in the body: one number, or nothing.
        self.is_exact = group.turns < 3 or not self.mu.any()
        self._xdot = state.xdot

    def potential(self, shapes: Array) -> Array | None:
        """Return V + ½ μᵀ I⁻¹ μ at shapes (…, m), or None if gravity turns the pivot."""
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

    def metric(self, shapes: Array) -> Array:
        """Return M at shapes, (…, m, m)."""
        return self._reduction.grid(shapes).reduced_metric

    def energy(self) -> float:
        """Return ½ ẋᵀ M ẋ + V + ½ μᵀ I⁻¹ μ at the time [J]."""
        potential = self.potential(self.x[None])
        rest = 0.0 if potential is None else float(potential[0])
        return rest + 0.5 * float(self._xdot @ self.metric(self.x[None])[0] @ self._xdot)


def _lack(motion: MotionSource, system: System | None) -> str:
    """Return why a motion read from a file has no potential, "" if it has."""
    if isinstance(motion, Trajectory):
        return ""
    if system is None:
        return " (the robot of the file is not found, hence no potential)"
    if not isinstance(motion.outputs, State):
        return " (the file leaves out the base, hence no potential)"
    if not _is_all_energy(motion.outputs, system):
        return " (the file does not hold its forces, hence no potential)"
    return ""


def _is_all_energy(states: State, system: System) -> bool:
    """Return whether the energy is that of Pinocchio's model alone, forces aside."""
    model, data = system.model, system.model.createData()
    q, v = system.sorted_q(states.q), system.sorted_v(states.v)
    off, size = [], 0.0
    for k in np.linspace(0, len(states.t) - 1, _TRIED).astype(int):
        H = symmetric(pin.crba(model, data, q[k]))
        kinetic = 0.5 * float(v[k] @ H @ v[k])
        potential = float(pin.computePotentialEnergy(model, data, q[k]))
        off.append(abs(states.energy[k] - kinetic - potential))
        size = max(size, kinetic + abs(potential))
    return bool(max(off) <= _CLOSE * size)


def _remark(names: Labels, landscape: _Landscape | None, values: Array | None) -> str:
    if landscape is None or values is None:
        return f" (gravity turns the pivot: no potential on the shape of {names.group} alone)"
    if _is_flat(values):
        return f" (the amended potential is {values.flat[0]:.4g} J everywhere)"
    return "" if landscape.is_exact else f", potential for μ of t = {landscape.time:g} s"


def _is_flat(values: Array) -> bool:
    return bool(np.ptp(values) <= _FLAT * max(_FLAT, float(np.abs(values).max())))


def _one(
    path: Path, names: Labels, shapes: Plane, landscape: _Landscape | None,
    values: Array | None, title: str,
) -> StyledFigure:  # fmt: skip
    (joint,), (x,) = shapes.joints, shapes.axes
    rows = 1 if values is None else 2
    made = figure(title, height=0.7 + 2.1 * rows + (0.6 if rows == 2 else 0.0))
    panels = made.subplots(
        rows, 1, sharex=True, squeeze=False,
        gridspec_kw={"height_ratios": [2, 3][-rows:]},
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
    portrait.set_xlabel(f"{names.joints[joint]} [{names.units[joint]}]")
    legend(portrait)
    return made


def _two(
    path: Path, names: Labels, shapes: Plane, landscape: _Landscape | None,
    values: Array | None, title: str,
) -> StyledFigure:  # fmt: skip
    made = figure(title, width=9.6, height=4.6)
    grid = made.add_gridspec(2, 2, width_ratios=[3, 2])
    main = made.add_subplot(grid[:, 0])
    a, b = shapes.joints
    if landscape is not None and values is not None and not _is_flat(values):
        field = main.contourf(*shapes.axes, values, levels=_LEVELS, cmap=FIELD)
        main.contour(*shapes.axes, values, levels=_LEVELS, colors=BLACK, linewidths=0.3)
        bar = made.colorbar(field, ax=main, location="left", pad=0.02)
        bar.set_label("amended potential [J]")
        energy = landscape.energy()
        if len(names.joints) == 2 and landscape.is_exact and values.min() < energy < values.max():
            main.contour(*shapes.axes, values, levels=[energy], colors="white", linewidths=1.8)
            main.plot([], [], color="#BBBBBB", linewidth=1.8, label="potential = energy")
    draw_path(main, path.x[:, a], path.x[:, b])
    main.grid(visible=False)
    main.set(xlim=shapes.axes[0][[0, -1]], ylim=shapes.axes[1][[0, -1]])
    main.set_xlabel(f"{names.joints[a]} [{names.units[a]}]")
    main.set_ylabel(f"{names.joints[b]} [{names.units[b]}]")
    main.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, frameon=False)
    for row, joint in enumerate((a, b)):
        axes = made.add_subplot(grid[row, 1])
        _portrait(axes, path, names, joint)
        axes.set_xlabel(f"{names.joints[joint]} [{names.units[joint]}]")
    return made


def _portrait(axes: Axes, path: Path, names: Labels, joint: int) -> None:
    """Draw rate against shape of one joint."""
    unit = names.units[joint].replace(" | ", "/s | ")
    x, rate = path.x[:, joint], path.xdot[:, joint]
    axes.plot(x, rate, color=BLUE, linewidth=1.6, label="path", zorder=3)
    axes.plot(x[:1], rate[:1], "o", color="white", markeredgecolor=BLACK, markersize=6,
              label="start", linestyle="none", zorder=5)  # fmt: skip
    axes.set_ylabel(f"rate [{unit}/s]")
