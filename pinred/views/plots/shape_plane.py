"""Lines and planes in shape space: one or two joints vary, the others are fixed.

A quantity over a plane is drawn as a colour map with level sets.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.contour import QuadContourSet
from matplotlib.patheffects import Stroke, withStroke
from matplotlib.ticker import MaxNLocator
from scipy.interpolate import RectBivariateSpline

from ...common.arrays import Array, as_floats, vectors
from ...common.errors import InputError
from ...system.joints import is_prismatic
from ...system.system import System
from .motion_labels import Labels
from .style import BLACK, FIELD, GREEN, SIGNED, legend

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
