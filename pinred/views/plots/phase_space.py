"""Figures of the phase space: phase portraits, Poincaré sections, and the momentum sphere."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from ...analysis.full_reduction import Reduction
from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, as_floats
from ...common.errors import InputError, SymmetryError
from ...lie.groups import GROUPS, group_named
from ...reduction.pointwise_reduction import symmetric
from ...simulation.read_recording import Recording
from ...simulation.trajectory import Trajectory
from ...system.state_fields import State, with_base
from ...system.system import System
from ..motion_source import (
    Labels,
    MotionSource,
    Path,
    charted_path,
    fine_path,
    fine_times,
    labels,
    moving_most,
    robot_of,
    shape_path,
    state_at,
)
from .connection_field import Limits, Plane, around, draw_path, mark_start, plane, title_at
from .style import BLACK, BLUE, FIELD, RED, StyledFigure, dots, figure, legend, line, styled

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


_HALVINGS = 64  # number of bisections, enough to resolve adjacent floating-point numbers


@checks_arguments
@styled
def poincare(
    motions: MotionSource | Sequence[MotionSource],
    *,
    joints: Sequence[str | int] | None = None,
    value: float | None = None,
    direction: int = 1,
) -> Figure:
    """Draw the rate of one joint against its value, whenever another joint crosses a value.

    A recording is interpolated by cubic splines between its times.  Balls have unwrapped rotation
    vectors and their derivatives.

    Args:
        motions: A motion, or several motions of one robot; each gets a separate marker.
        joints: Names or indices of the crossing joint and the drawn joint; the first two if None.
        value: Value of the crossing joint [rad | m], modulo 2π for hinges; the middle of its range
            if None.
        direction: Sign of the rate at the crossing: 1, −1, or 0 for both.
    Returns:
        The figure.
    Raises:
        InputError: Fewer than two joints, motions of several robots, or no crossing.
    """
    sources = [motions] if isinstance(motions, (Trajectory, Recording)) else list(motions)
    if not sources:
        raise InputError("a Poincaré section takes one or more motions, got none")
    names = labels(sources[0])
    if any(labels(motion) != names for motion in sources):
        raise InputError("a Poincaré section takes motions of one robot only")
    crossed, shown = names.pair(joints, "a Poincaré section")
    if direction not in (-1, 0, 1):
        raise InputError(f"direction must be 1, -1 or 0 for both, got {direction!r}")
    unit = names.units[crossed]
    if value is None:
        x = charted_path(sources[0]).x[:, crossed]
        value = 0.5 * float(x.min() + x.max())
    where = float(as_floats(value, "value"))
    if not np.isfinite(where):
        raise InputError(f"value must be finite, got {value}")
    turns = unit == "rad" and not _of_ball(sources[0], crossed)
    points = [
        section(motion, crossed, where, direction, turns=turns, shown=shown) for motion in sources
    ]
    if not any(len(crossed_at) for crossed_at in points):
        raise InputError(
            f"'{names.joints[crossed]}' does not cross {where:g} {unit} in this direction; "
            "choose another value or a longer motion"
        )
    sense = {1: ", upwards", -1: ", downwards", 0: ""}[direction]
    drawing = figure(
        f"{names.robot}: Poincaré section at {names.joints[crossed]} = {where:.4g} {unit}{sense}",
        height=4.2,
    )
    axes = drawing.subplots()
    size = 5.0 if max(map(len, points)) < 100 else 2.5
    for k, crossed_at in enumerate(points):
        axes.plot(
            *crossed_at.T, linestyle="none", markersize=size, markeredgewidth=0.0,
            label=f"motion {k + 1}: {len(crossed_at)} crossings", **dots(k),
        )  # fmt: skip
    rate = f"rate of {names.joints[shown]} [{names.units[shown]}/s]"
    axes.set(xlabel=names.with_unit(shown), ylabel=rate)
    legend(axes)
    return drawing


def _of_ball(motion: MotionSource, joint: int) -> bool:
    """Return whether a coordinate is an entry of the rotation vector of a ball."""
    system = robot_of(motion)
    return system is not None and joint in system.space.ball_v


def section(
    motion: MotionSource, joint: int, value: float, direction: int, *, turns: bool, shown: int
) -> Array:
    """Compute the value and rate of a joint at the crossings of another joint.

    Args:
        motion: The motion.
        joint: Index of the crossing joint.
        value: Value at the crossing [rad | m].
        direction: Sign of the rate at the crossing: 1, −1, or 0 for both.
        turns: Whether values that differ by full rotations count as crossings.
        shown: Index of the other joint.
    Returns:
        (K, 2) value and rate of the other joint, in order of time.
    """
    path = shape_path(motion)

    def height(t: Array) -> Array:
        distance = path(t)[0][:, joint] - value
        return np.sin(0.5 * distance) if turns else distance

    t = crossings(motion, height)
    if not t.size:
        return np.empty((0, 2))
    x, xdot = path(t)
    points = np.stack([x[:, shown], xdot[:, shown]], axis=1)
    return points if not direction else points[np.sign(xdot[:, joint]) == direction]


def crossings(motion: MotionSource, function: Callable[[Array], Array]) -> Array:
    """Find the times at which a continuous function changes its sign, by bisection.

    Two crossings within an eighth of an integration step, or of a report interval, are missed.

    Args:
        motion: The motion, whose steps are searched.
        function: Function from times (T,) to values (T,).
    Returns:
        Times of the crossings, (K,) [s].
    """
    t = fine_times(motion)
    # An exact zero is assigned the sign of the previous value, so that its crossing counts once.
    signs = np.sign(function(t))
    for k in np.flatnonzero(signs == 0.0):
        signs[k] = signs[k - 1] if k else 0.0
    change = signs[:-1] * signs[1:] < 0.0
    low, high, sign = t[:-1][change], t[1:][change], signs[:-1][change]
    if not low.size:
        return low
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        before = np.sign(function(middle)) == sign
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    return np.asarray(high)


_NONE = 1e-12  # largest momentum that counts as zero, relative to moment of inertia times 1 rad/s
_CONSTANT = 1e-6  # largest relative change of |L| that counts as constant
_CURVES = 4  # number of energy level curves on each side of the separatrix
_POINTS = 181  # number of points of a level curve


@checks_arguments
@styled
def sphere(motion: MotionSource, *, when: float = 0.0) -> Figure:
    """Draw the path of the angular momentum in the body frame on its sphere.

    The momentum refers to the pivot (SO3) or to the centre of mass (SE3). Thin curves are
    levels of the energy ½ Lᵀ I⁻¹ L with locked joints; a rigid body stays on one of them. If the
    robot of a recording is not available, no levels are drawn.

    Args:
        motion: Trajectory, or a recording read from a file.
        when: Time at which the joints are locked [s]; a recording uses its nearest time.
    Returns:
        The figure.
    Raises:
        InputError: Another group, or zero momentum.
        LoadError: SE3 needs the robot of a recording, which cannot be loaded.
    """
    names = labels(motion)
    L = angular_momentum(motion, fine_path(motion))
    size = float(np.linalg.norm(L[0]))
    inertia = None
    if (system := robot_of(motion)) is not None:
        frozen_at = state_at(motion, when)
        inertia = _frozen_inertia(system, frozen_at.x)
    least = _NONE * (1.0 if inertia is None else float(np.trace(inertia)))
    if size <= least:
        raise InputError(f"'{names.robot}' has zero angular momentum, which cannot be drawn")
    steady = np.ptp(np.linalg.norm(L, axis=1)) <= _CONSTANT * size
    about = "pivot" if group_named(names.group).is_pivot else "centre of mass"
    drawing = figure(
        f"{names.robot}: angular momentum about the {about}, in the body's frame\n"
        + (f"|L| = {size:.4g} N·m·s" if steady else f"|L| changes from {size:.4g} N·m·s (sphere)"),
        height=5.4,
    )
    axes: Any = drawing.add_subplot(projection="3d", computed_zorder=False)
    angles = _view(L)
    view = _direction(*angles)
    axes.set_proj_type("ortho")
    axes.view_init(*angles)
    _ball(axes, size, view)
    if inertia is not None:
        frozen = "" if not names.joints else f", shape of t = {float(frozen_at.t):g} s"
        curves = level_curves(inertia, size)
        for k, curve in enumerate(curves):
            _draw(axes, curve, view, f"levels of the energy{frozen}" if k == 0 else "",
                  color="#777777", linewidth=0.8)  # fmt: skip
    _draw(axes, L, view, "path", color=RED, linewidth=2.2)
    mark_start(axes, *L.T)
    reach = 1.05 * max(size, float(np.abs(L).max()))
    _draw_axes(axes, reach)
    drawing.legend(loc="outside lower left", ncols=3, frameon=False)
    return drawing


def angular_momentum(motion: MotionSource, path: Path) -> Array:
    """Compute the angular momentum in the body frame along a path of a motion.

    Args:
        motion: The motion.
        path: States of the motion, at T times.
    Returns:
        (T, 3) angular momentum [N·m·s].
    Raises:
        InputError: The symmetry group is neither SO3 nor SE3.
        LoadError: SE3 needs the robot of a recording, which cannot be loaded.
    """
    group = group_named(labels(motion).group)
    if group.turns < 3:
        names = " and ".join(g.name for g in GROUPS.values() if g.turns == 3)
        raise InputError(f"the body momentum moves on a sphere for {names}, not for {group}")
    mu = with_base(path, labels(motion).robot).body_momentum
    if group.is_pivot:
        return mu
    return group.about(Reduction(motion.system).grid(path.x).com, mu)


def level_curves(inertia: Array, size: float) -> list[Array]:
    """Return curves of equal energy ½ Lᵀ I⁻¹ L on the sphere |L| = size, each (P, 3).

    Let a < b < c be the eigenvalues of I⁻¹ and 2h the level for |L| = 1. In principal axes, a curve
    about the first axis projects to the ellipse L2² (b − a) + L3² (c − a) = 2h − a, and similarly
    about the third axis. The first two curves are the separatrix.
    """
    values, axes = np.linalg.eigh(np.linalg.inv(inertia))
    a, b, c = values
    gap = 1e-9 * c
    levels: list[tuple[float, int]] = []
    if b - a > gap and c - b > gap:
        levels.append((b, 0))
    fractions = (np.arange(_CURVES) + 0.5) / _CURVES
    if b - a > gap:
        levels += [(a + f**2 * (b - a), 0) for f in fractions]
    if c - b > gap:
        levels += [(c - f**2 * (c - b), 2) for f in fractions]
    s = np.linspace(0.0, 2.0 * np.pi, _POINTS)
    curves = []
    for level, about in levels:
        first, second = (k for k in range(3) if k != about)
        L = np.zeros((_POINTS, 3))
        for k, wave in ((first, np.cos(s)), (second, np.sin(s))):
            L[:, k] = np.sqrt((level - values[about]) / (values[k] - values[about])) * wave
        L[:, about] = np.sqrt(np.maximum(1.0 - np.sum(L**2, axis=1), 0.0))
        for sign in (1.0, -1.0):
            curve = L.copy()
            curve[:, about] *= sign
            curves.append(np.asarray(size * curve @ axes.T))
    return curves


def _frozen_inertia(system: System, x: Array) -> Array:
    """Compute the inertia (3, 3) of the robot with joints locked at x, see `sphere`."""
    I = Reduction(system).locked_inertia(x)
    return I if len(I) == 3 else np.asarray(np.linalg.inv(np.linalg.inv(I)[3:, 3:]))


def _view(L: Array) -> tuple[float, float]:
    """Return the elevation and azimuth [deg] of a view that shows the path and all three axes."""
    mean = np.mean(L, axis=0)
    if np.linalg.norm(mean) < 0.2 * np.linalg.norm(L[0]):
        mean = L[0]
    up = np.degrees(np.arcsin(np.clip(mean[2] / np.linalg.norm(mean), -1.0, 1.0)))
    azimuth = 30.0 + 90.0 * np.round((np.degrees(np.arctan2(mean[1], mean[0])) - 30.0) / 90.0)
    return float(np.copysign(np.clip(abs(up), 25.0, 50.0), up)), float(azimuth)


def _direction(elevation: float, azimuth: float) -> Array:
    up, turn = np.radians([elevation, azimuth])
    return np.array([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)])


def _draw(axes: Any, curve: Array, view: Array, label: str, **look: Any) -> None:
    """Draw a curve on the sphere, pale and dotted on its far side."""
    front = curve @ view >= 0.0
    near, far = curve.copy(), curve.copy()
    near[~front] = np.nan
    far[front] = np.nan
    if front.any() or label:
        axes.plot(*near.T, label=label or "_near", zorder=4, **look)
    if not front.all():
        axes.plot(*far.T, label="_far", zorder=2, **{**look, "linestyle": ":", "alpha": 0.45})


def _ball(axes: Any, size: float, view: Array) -> None:
    """Draw the sphere as a disc, its parallel projection."""
    s = np.linspace(0.0, 2.0 * np.pi, _POINTS)
    _, _, across = np.linalg.svd(view[None])
    rim = size * (np.cos(s)[:, None] * across[1] + np.sin(s)[:, None] * across[2])
    disc = Poly3DCollection([rim], facecolor="#EAF3F9", edgecolor="#8FB8D3", linewidth=0.8)
    disc.set_zorder(1)
    axes.add_collection3d(disc)


def _draw_axes(axes: Any, reach: float) -> None:
    """Set limits, labels and units of the three axes."""
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), zlim=(-reach, reach))
    axes.set_box_aspect((1, 1, 1))
    axes.set(xlabel="L1 [N·m·s]", ylabel="L2 [N·m·s]", zlabel="L3 [N·m·s]")
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color("white")
        axis.set_major_locator(MaxNLocator(4, symmetric=True))
