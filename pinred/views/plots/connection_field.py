"""Connections over two joints: curvature, terms of the curvature, or vector field.

One or two joints vary, the others are fixed: a line or a plane in shape space.  A quantity over a
plane is drawn as a colour map with level sets.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.contour import QuadContourSet
from matplotlib.figure import Figure
from matplotlib.patheffects import Stroke, withStroke
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike
from scipy.interpolate import RectBivariateSpline

from ...analysis.connections.connection import (
    Connection,
    ConnectionSource,
    connection_of,
    rest_of,
    robot_of,
)
from ...analysis.full_reduction import Reduction
from ...analysis.phases.gait import Gait
from ...analysis.phases.phase import phase
from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, as_floats, vector, vectors
from ...common.errors import InputError, PinredError
from ...common.names import component_index
from ...lie.group import Group
from ...simulation.read_recording import Recording
from ...simulation.trajectory import Trajectory
from ...system.joints import is_prismatic
from ...system.system import System, checked_system
from ..motion_source import Labels, MotionSource, fine_path, labels_of, labels_of_connection
from .style import BLACK, FIELD, GREEN, SIGNED, figure, legend, styled

Part = Literal["curvature", "exterior", "bracket", "connection"]
_PARTS = ("curvature", "exterior", "bracket", "connection")
_ALONG_GAIT = 400
MOVED = 1e-6  # smallest turn [rad] or displacement [m] of a cycle that counts as a motion

Source: TypeAlias = System | Connection | Reduction | MotionSource


@checks_arguments
@styled
def field(
    source: ConnectionSource,
    *,
    joints: Sequence[str | int] | None = None,
    component: str | int | None = None,
    part: Part = "curvature",
    limits: Limits | None = None,
    at: ArrayLike | None = None,
    gait: Gait | None = None,
) -> Figure:
    """Draw a component of a connection's curvature over two joints, with its zero contour.

    Args:
        source: The connection, or a System for its mechanical connection. Rotation vectors are the
            coordinates of balls (`in_chart`).
        joints: Names or indices of two joints; if None, the two that the gait moves most, or else
            the first two.
        component: v1 … ω3 (or w3, x, y, z, turn), or an index in the body twist. If None, the one
            that a cycle of the gait moves (`moved_component`), or else the rotation with the
            largest values.
        part: "curvature" B, its terms "exterior" ∂_αA_β − ∂_βA_α and "bracket" [A_α, A_β], or
            "connection": the row of −A as a vector field with flow lines over its magnitude.
        limits: (low, high) of each joint [rad | m]; around the gait, or ±π if None.
        at: Shape of the other joints, (m,) [rad | m]; if None, the start of the gait, or else zero,
            or the assembled shape of a robot with loops.
        gait: Gait to draw. The title gives its signed area, and the integral of the field over
            that area if the gait moves only these two joints.
    Returns:
        The figure.
    Raises:
        InputError: `source` is not a Connection, or an option is invalid.
    """
    source = connection_of(source, "field")
    if part not in _PARTS:
        raise InputError(f"part must be one of {', '.join(_PARTS)}, got {part!r}")
    source = source.in_chart()
    names = labels_of_connection(source)
    path = None if gait is None else _closed_path(source, gait)
    pair = names.pair(joints, "a field", path)
    start = rest_of(source) if path is None else path[0]
    frozen = start if at is None else vector(at, source.m, "at", source.joints)
    units = [source.form.units[k] for k in pair]
    if limits is None:
        limits = [(-np.pi, np.pi)] * 2 if path is None else around(path[:, pair], units)
    shapes = plane(pair, limits, frozen)
    grid = source.grid(shapes.shapes)
    if component is None and gait is not None:
        with suppress(PinredError):  # A gait may cross shapes without a connection.
            component = moved_component(source.group, phase(source, gait).pose)
    if part == "connection":
        local = -grid.local[..., pair]
        index = component_of(source.group, component, np.linalg.norm(local, axis=-1))
        values = np.linalg.norm(local[..., index, :], axis=-1)
    else:
        components = getattr(grid, part)[..., pair[0], pair[1]]
        index = component_of(source.group, component, components)
        values = components[..., index]
    label = source.group.twist_names[index]
    a, b = (source.joints[k] for k in pair)
    titles = {"curvature": "B", "exterior": "dA", "bracket": "[A, A]", "connection": "−A"}
    per = "joint motion" if part == "connection" else "area"
    title = (
        f"{robot_name(source)}: {motion_word(source.group, index)} per {per}, "
        f"{titles[part]}({a}, {b}), component {label}"
    )
    if slice_ := title_at(names, pair, frozen):
        title += f"\n{slice_}"
    if gait is not None and path is not None:
        title += _enclosed(source, gait, pair, part, index)
    drawing = figure(title, height=4.4)
    axes = drawing.subplots()
    is_flow = part == "connection"
    unit = (
        unit_of_curvature(label, units).partition("/")[0]
        if is_flow
        else unit_of_curvature(label, units)
    )
    if is_flow:
        unit += f"/{units[0]}" if units[0] == units[1] else f"/({' | '.join(units)})"
    what = f"{titles[part]}, component {label} [{unit}]"
    axes_labels = [names.with_unit(k) for k in pair]
    draw_field(axes, shapes, values, axes_labels, what, path=path, contours=not is_flow)
    if is_flow:
        flow = local[..., index, :]
        u, v = shapes.axes
        axes.streamplot(u, v, flow[..., 0], flow[..., 1], color=BLACK, linewidth=0.6, arrowsize=0.8)
    return drawing


def _closed_path(source: Connection, gait: Gait) -> Array:
    if gait.m != source.m:
        raise InputError(f"the gait moves {gait.m} joints, but {source.title()} has {source.m}")
    return gait.at(np.linspace(0.0, gait.period, _ALONG_GAIT + 1))[0]


def _enclosed(source: Connection, gait: Gait, pair: list[int], part: str, which: int) -> str:
    """Format the gait's signed area, and the integral of the field over it, for the title."""
    if gait.turns:
        return ""  # A path around a torus encloses no area.
    x, xdot = gait.samples(4096)
    a, b = pair
    area = 0.5 * gait.period * float(np.mean(x[:, a] * xdot[:, b] - x[:, b] * xdot[:, a]))
    text = f"\nsigned area of the gait {area:.4g}"
    fixed = [k for k in range(source.m) if k not in pair]
    if part == "connection" or np.ptp(x[:, fixed], axis=0).max(initial=0.0) > 0.0:
        return text
    # Integrate over the cone from the centre of the path, which has the gait's signed area.
    rho, weights = np.polynomial.legendre.leggauss(16)
    rho, weights = 0.5 * (rho + 1.0), 0.5 * weights
    centre = x.mean(axis=0)
    cone = centre + rho[:, None, None] * (x - centre)
    values = getattr(source.grid(cone), part)[..., which, a, b]
    swept = (x - centre)[:, a] * xdot[:, b] - (x - centre)[:, b] * xdot[:, a]
    terms = (weights * rho)[:, None] * values * swept
    integral = gait.period * float(np.mean(terms.sum(axis=0)))
    if abs(integral) < NONE * gait.period * float(np.mean(np.abs(terms).sum(axis=0))):
        integral = 0.0
    return f"{text}, integral over it {integral:.4g}"


@checks_arguments
@styled
def curvature(
    source: Source,
    *,
    joints: Sequence[str | int] | None = None,
    component: str | int | None = None,
    limits: Limits | None = None,
    at: ArrayLike | None = None,
    path: ArrayLike | None = None,
) -> Figure:
    """Draw a component of the curvature B_αβ over the joints α and β, with its zero contour.

    The coordinates of a ball are its rotation vector, and B_αβ belongs to these coordinates.

    Args:
        source: A System, a Connection, a Reduction, or a motion, whose path is drawn.
        joints: Names or indices of two joints, or axes of balls; if None, the two that move most
            on the path, or else the first two.
        component: v1 … ω3 (or w3, x, y, z, turn), or an index in the body twist. If None, the
            rotation with the largest values.
        limits: (low, high) of each joint [rad | m]; around the path, or their range if None.
        at: Shape of the other joints, (nx,) [rad | m | 1]; the initial shape, or rest if None.
        path: Shapes to draw, (T, nx) [rad | m | 1]; the shapes of the motion if None.
    Returns:
        The figure.
    Raises:
        InputError: Fewer than two joints, or an invalid option.
        LoadError: The robot of a recording cannot be loaded.
    """
    if isinstance(source, Connection):
        if path is not None:
            raise InputError(
                "path: a Connection draws gaits; use plot(connection, 'field', gait=…)"
            )
        return field(source, joints=joints, component=component, limits=limits, at=at)
    system = _system(source)
    names, chart = labels_of(system), system.space.chart
    drawn: Array | None = None
    if path is not None:
        drawn = chart(checked_path(path, system.nx))
    elif isinstance(source, (Trajectory, Recording)):
        drawn = chart(fine_path(source).x)
    pair = names.pair(joints, "a plot of the curvature", drawn)
    start = np.zeros(system.m) if drawn is None else drawn[0]
    frozen = start
    if at is not None:
        frozen = chart(vector(at, system.nx, "at", system.x_names)[None])[0]
    units = [names.units[k] for k in pair]
    if limits is None:
        limits = reach(system, pair) if drawn is None else around(drawn[:, pair], units)
    shapes = plane(pair, limits, frozen)
    over = Connection.mechanical(system).in_chart() if system.space.balls else Reduction(system)
    B = over.grid(shapes.shapes).curvature[..., pair[0], pair[1]]
    index = component_of(system.group, component, B)
    values = B[..., index]
    flat = float(np.abs(values).max()) < NONE
    label = system.group.twist_names[index]
    a, b = (names.joints[k] for k in pair)
    frozen_joints = title_at(names, pair, frozen)
    drawing = figure(
        f"{names.robot}: {motion_word(system.group, index)} per area, curvature B({a}, {b}), "
        f"component {label}"
        + (", is zero everywhere" if flat else "")
        + (f"\n{frozen_joints}" if frozen_joints else ""),
        height=4.4,
    )
    what = f"B, component {label} [{unit_of_curvature(label, units)}]"
    axes_labels = [names.with_unit(k) for k in pair]
    draw_field(drawing.subplots(), shapes, values, axes_labels, what, path=drawn)
    return drawing


def _system(source: Source) -> System:
    if isinstance(source, (Trajectory, Recording, Reduction)):
        return source.system
    return checked_system(
        source, "a plot of the curvature (a Reduction or a motion does, too)",
        remedy="Plot the field of their Connection.mechanical over independent joints.",
    )  # fmt: skip


def moved_component(group: Group, pose: Array) -> int | None:
    """Return the twist component in which a displacement moves most; a turn has precedence.

    Args:
        group: The symmetry group.
        pose: The displacement, (size,).
    Returns:
        The index of the largest rotation above MOVED, or else of the largest translation above it;
        None if there is neither.
    """
    k = group.linear
    turn = pose[-1:] if group.turns == 1 else group.log(pose)[k:]  # a full turn has the log 0
    for first, part in ((k, turn), (0, pose[:k])):
        if np.abs(part).max(initial=0.0) > MOVED:
            return first + int(np.argmax(np.abs(part)))
    return None


def motion_word(group: Group, index: int) -> str:
    """Return the motion along a twist component: "displacement along x", "turn about y"."""
    if index < group.linear:
        alone = group.linear == 1
        return "displacement" if alone else f"displacement along {group.pose_names[index]}"
    return "turn" if group.turns == 1 else f"turn about {'xyz'[group.axes[index] - 3]}"


def robot_name(source: Connection) -> str:
    """Return the name of the robot of a connection, or what its form states without one."""
    robot = robot_of(source)
    return source.form.what if robot is None else robot.name


def component_of(group: Group, component: str | int | None, B: Array) -> int:
    """Return the index of a body twist component; if None, of the rotation with the largest B."""
    names, linear = group.twist_names, group.linear
    if component is None:
        size = np.abs(B).reshape(-1, len(names)).max(axis=0)
        first = linear if linear < len(names) else 0
        return first + int(np.argmax(size[first:]))
    if isinstance(component, str):
        return component_index(component, group.components("twist"), f"component of {group.name}")
    if isinstance(component, bool) or not 0 <= component < len(names):
        raise InputError(
            f"component: expected an index below {len(names)} or a name, got {component!r}; the "
            f"components of {group.name} are {', '.join(names)}"
        )
    return int(component)


def unit_of_curvature(label: str, units: Sequence[str]) -> str:
    """Return the unit of a curvature component over two joints with these units."""
    numerator = "m" if label.startswith("v") else "rad"
    a, b = units
    return f"{numerator}/{a}²" if a == b else f"{numerator}/({a}·{b})"


PATH = GREEN  # colour of paths, which level curves do not have
_POINTS = {1: 241, 2: 61}  # number of points along each axis of a line or a plane
Limits: TypeAlias = Sequence[Sequence[float]]
_MARGIN = 0.2  # margin around a path, relative to the extent of the path
_LEAST = {"rad": 0.4, "m": 0.05}  # half of the smallest axis range, by unit
_SLIDE = 0.5  # half of the axis range of a prismatic joint without limits [m]

NONE = 1e-12  # values and differences below this count as round-off
_ROUND_OFF = 1e-10  # the same, relative to the largest value
_LEVELS = 20
_REFINED = 4  # number of drawn cells along each side of a cell of the grid
_LISTED, _MOST_LISTED = 3, 8  # numbers of fixed joints of which zeros, or further ones, are counted


@dataclass(frozen=True)
class Plane:
    """Shapes in which one or two joints vary.

    Attributes:
        joints: Indices of the varying joints.
        axes: Values of each varying joint, (P,) [rad | m].
        shapes: (P, m) for one joint; (P, P, m) for two, the second joint along the first axis, as
            contour plots require.
    """

    joints: tuple[int, ...]
    axes: tuple[Array, ...]
    shapes: Array


def plane(joints: Sequence[int], limits: Limits, at: Array) -> Plane:
    """Build the grid of shapes in which one or two joints vary within limits.

    Args:
        joints: Indices of one or two joints.
        limits: (low, high) of each varying joint [rad | m].
        at: Values of the other joints, (m,) [rad | m].
    Returns:
        The shapes.
    Raises:
        InputError: The limits are not a finite, increasing pair for each joint.
    """
    bounds = as_floats(limits, "limits")
    if bounds.shape != (len(joints), 2) or not np.isfinite(bounds).all():
        raise InputError(
            f"limits must be a finite (low, high) for each of {len(joints)} joints, got {limits}"
        )
    if (bounds[:, 0] >= bounds[:, 1]).any():
        raise InputError(f"limits must increase, got {limits}")
    axes = tuple(np.linspace(low, high, _POINTS[len(joints)]) for low, high in bounds)
    grids = np.meshgrid(*axes)
    shapes = np.broadcast_to(at, (*grids[0].shape, len(at))).copy()
    for joint, grid in zip(joints, grids, strict=True):
        shapes[..., joint] = grid
    return Plane(tuple(joints), axes, shapes)


def around(path: Array, units: Sequence[str]) -> list[tuple[float, float]]:
    """Return limits that enclose a path (T, k) with a margin."""
    limits = []
    for values, unit in zip(path.T, units, strict=True):
        low, high = float(values.min()), float(values.max())
        half = max(0.5 * (high - low) * (1.0 + 2.0 * _MARGIN), _LEAST.get(unit, 0.4))
        limits.append((0.5 * (low + high) - half, 0.5 * (low + high) + half))
    return limits


def reach(system: System, joints: Sequence[int]) -> list[tuple[float, float]]:
    """Return the axis range of each joint: ±π or ±0.5 m, or its position limits if narrower."""
    limits = []
    for k in joints:
        joint = system.model.joints[system.joints[k]]
        low, high = (-_SLIDE, _SLIDE) if is_prismatic(joint) else (-np.pi, np.pi)
        least = float(system.model.lowerPositionLimit[joint.idx_q])
        most = float(system.model.upperPositionLimit[joint.idx_q])
        if joint.nq == 1 and least < most:
            low, high = max(low, least), min(high, most)
        limits.append((low, high))
    return limits


def checked_path(path: Any, m: int) -> Array:
    """Validate shapes over time (T, m); raise ShapeError or InputError."""
    array = vectors(path, m, "path")
    if array.ndim != 2 or len(array) == 0:
        raise InputError(f"path must be shapes over time, (T, {m}), got shape {array.shape}")
    return array


def draw_path(axes: Axes, x: Array, y: Array) -> None:
    """Draw a curve with a white outline over a field, and a dot at its start."""
    halo = [Stroke(linewidth=4.0, foreground="white"), withStroke(linewidth=0.0)]
    axes.plot(x, y, color=PATH, linewidth=2.0, label="path", path_effects=halo, zorder=4)
    mark_start(axes, x, y)


def mark_start(axes: Any, *path: Array) -> None:
    """Draw a dot at the first point of a path, given by its coordinates, (T,) each."""
    axes.plot(
        *(values[:1] for values in path), "o", color="white", markeredgecolor=BLACK, markersize=6,
        label="start", linestyle="none", zorder=6,
    )  # fmt: skip


def title_at(names: Labels, joints: Sequence[int], at: Array) -> str:
    """Format the values of the fixed joints for a title; "" if no joint is fixed."""
    fixed = [k for k in range(len(names.joints)) if k not in joints]
    if not fixed:
        return ""
    # Many zeros are counted, not listed.
    listed = fixed if len(fixed) <= _LISTED else [k for k in fixed if abs(at[k]) > NONE]
    phrases = [f"{names.joints[k]} = {at[k]:.3g} {names.units[k]}" for k in listed[:_MOST_LISTED]]
    if further := len(listed) - len(phrases):
        phrases.append(f"{further} joint{'s' * (further > 1)} more")
    if zeros := len(fixed) - len(listed):
        phrases.append(f"{zeros} {'other ' * bool(phrases)}joint{'s' * (zeros > 1)} at 0")
    return "drawn for " + ", ".join(phrases)


def draw_field(
    axes: Axes, plane: Plane, values: Array, labels: Sequence[str], value: str, *,
    path: Array | None = None, contours: bool = True,
) -> None:  # fmt: skip
    """Draw a function of two joints in colours, with a colour bar and a legend.

    Args:
        axes: Axes in which the function is drawn.
        plane: The shapes.
        values: The function, on the grid of the plane.
        labels: Names and units of both joints; axes of equal units have equal scales.
        value: Name and unit of the function.
        path: Shapes of a path to draw, (T, m) [rad | m].
        contours: Whether to draw level curves.
    """
    fine, values = refine(plane.axes, values)
    filled = _fill(axes, fine, values)
    if contours:
        _outline(axes, fine, values, filled)
    if path is not None:
        draw_path(axes, *path[:, list(plane.joints)].T)
    axes.grid(visible=False)
    x, y = plane.axes
    axes.set(xlabel=labels[0], ylabel=labels[1], xlim=x[[0, -1]], ylim=y[[0, -1]])
    if unit_of(labels[0]) == unit_of(labels[1]):
        axes.set_aspect("equal", adjustable="box")
    bar = axes.figure.colorbar(filled, ax=axes, location="left", pad=0.02, shrink=0.9)
    bar.set_label(value)
    legend(axes)


def refine(plane: Sequence[Array], values: Array) -> tuple[list[Array], Array]:
    """Interpolate values on a finer grid by cubic splines, so that level curves have no corners.

    Round-off becomes zero. Otherwise a zero contour along a row or a diagonal of the grid, as
    symmetries of the robot cause, would wind around the points of the grid.

    Args:
        plane: Values of both joints, (P,) each.
        values: The function, (P, P), the second joint along the first axis.
    Returns:
        Finer values of both joints, and the function.
    """
    fine = [np.interp(np.arange(len(x) * _REFINED - _REFINED + 1) / _REFINED, np.arange(len(x)), x)
            for x in plane]  # fmt: skip
    values = RectBivariateSpline(*plane[::-1], values)(*fine[::-1])
    return fine, np.where(np.abs(values) < _ROUND_OFF * np.abs(values).max(), 0.0, values)


def _fill(axes: Axes, plane: Sequence[Array], values: Array) -> QuadContourSet:
    """Draw values at the points of a plane of shapes as filled contours."""
    low, high = float(values.min()), float(values.max())
    if high - low < NONE:
        low, high = low - 1.0, high + 1.0
    signed = low < 0.0 < high
    if signed:  # a symmetric range puts zero in the middle of the colour map
        low, high = -max(-low, high), max(-low, high)
    levels = MaxNLocator(_LEVELS).tick_values(low, high)
    return axes.contourf(*plane, values, levels=levels, cmap=SIGNED if signed else FIELD)


def unit_of(label: str) -> str:
    """Return the unit in the label of an axis, "name [unit]"."""
    return label.rpartition(" [")[2]


def _outline(axes: Axes, plane: Sequence[Array], values: Array, filled: QuadContourSet) -> None:
    """Draw every second level as a thin line, and zero as a thick one, unless all is round-off."""
    if np.abs(values).max() < NONE:
        return
    levels = np.asarray(filled.levels)
    thin = [level for level in levels[::2] if abs(level) > NONE]
    # By default, matplotlib would dash the lines of negative levels.
    style: dict[str, Any] = {"colors": BLACK, "linestyles": "-"}
    axes.contour(*plane, values, levels=thin, linewidths=0.4, **style)
    if values.min() < 0.0 < values.max():
        axes.contour(*plane, values, levels=[0.0], linewidths=1.2, **style)
        axes.plot([], [], color=BLACK, linewidth=1.2, label="zero")
