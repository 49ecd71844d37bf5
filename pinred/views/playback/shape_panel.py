"""The shape panel: the path in shape space over the curvature of the connection."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...analysis.full_reduction import Reduction
from ...common.arrays import Array, FrozenArrays
from ...common.errors import InputError
from ...lie.group import Group
from ...system.system import System

_FINE = 61  # number of grid points along each axis of the curvature field
_MARGIN = 0.15  # margin around the path, relative to the range of the path
_TURN = 2.0 * np.pi
_LEAST = 0.2  # smallest range of an axis [rad | m]


@dataclass(frozen=True)
class ShapePanel(FrozenArrays):
    """A path in the plane of two coordinates; arrays are read-only.

    With a single joint, the second axis is the joint rate, and there is no curvature field. The
    field is also missing if a joint makes more rotations than the grid can resolve.

    Attributes:
        labels: Labels of the axes, with units.
        path: The path, (F, 2).
        low: Lower limits of the axes, (2,).
        high: Upper limits of the axes, (2,).
        components: Names of the components of the curvature B_αβ, with units.
        field: Curvature over both joints, (components, N, N), with the other joints at their values
            in the first frame.
    """

    labels: tuple[str, str]
    path: Array
    low: Array
    high: Array
    components: tuple[str, ...]
    field: Array


def shape_panel(
    system: System, x: Array, xdot: Array, pair: tuple[str, str] | None = None
) -> ShapePanel | None:
    """Compute the shape panel; None for a rigid body, which has no joints.

    Args:
        system: The robot.
        x: Shapes, (F, nx) [rad | m | 1].  Balls are drawn by their rotation vectors.
        xdot: Shape rates, (F, m) [rad/s | m/s].
        pair: Names of the joints on the axes. If None, the two joints that move most, preferably
            without full rotations.
    Returns:
        The panel.
    Raises:
        InputError: A joint is unknown.
    """
    names, units = system.shape_names, system.units
    for name in pair or ():
        if name not in names:
            raise InputError(f"pair: no joint '{name}'; the joints are {', '.join(names)}")
    if not system.m:
        return None
    x = system.space.chart(x)
    if system.m == 1:
        labels = (f"{names[0]} [{units[0]}]", f"rate of {names[0]} [{units[0]}/s]")
        path = np.column_stack([x[:, 0], xdot[:, 0]])
        return ShapePanel(labels, path, *_range(path), (), np.empty((0, 0, 0)))
    if pair is None:
        ranges = np.ptp(x, axis=0)
        spins = (ranges > _TURN) & np.array([unit == "rad" for unit in units])
        a, b = sorted(map(int, np.lexsort((-ranges, spins))[:2]))
    else:
        a, b = names.index(pair[0]), names.index(pair[1])
    path = x[:, [a, b]]
    low, high = _range(path)
    labels = (f"{names[a]} [{units[a]}]", f"{names[b]} [{units[b]}]")
    # The field is drawn over coordinates, which rotation vectors of balls are not.  Shapes off the
    # closed ones have no meaning for robots with loops.
    if (
        system.space.balls
        or system.loops
        or (high - low)[[units[k] == "rad" for k in (a, b)]].max(initial=0.0) > _FINE / 12 * _TURN
    ):
        return ShapePanel(labels, path, low, high, (), np.empty((0, 0, 0)))
    shapes = np.broadcast_to(x[0], (_FINE, _FINE, system.m)).copy()
    shapes[..., a] = np.linspace(low[0], high[0], _FINE)[:, None]
    shapes[..., b] = np.linspace(low[1], high[1], _FINE)[None, :]
    field = np.moveaxis(Reduction(system).grid(shapes).curvature[..., a, b], -1, 0)
    components = _sort_components(system, field, f"({units[a]}·{units[b]})")
    return ShapePanel(labels, path, low, high, *components)


def _range(path: Array) -> tuple[Array, Array]:
    low, high = path.min(axis=0), path.max(axis=0)
    half = np.maximum((0.5 + _MARGIN) * (high - low), 0.5 * _LEAST)
    return 0.5 * (low + high) - half, 0.5 * (low + high) + half


def _sort_components(system: System, field: Array, per: str) -> tuple[tuple[str, ...], Array]:
    """Sort the components of the field, rotations first, each kind by decreasing magnitude."""
    linear, r = system.group.linear, system.r
    names = [
        f"{words} [{'m' if k < linear else 'rad'}/{per}]"
        for k, words in enumerate(motion_words(system.group))
    ]
    strength = np.abs(field).max(axis=(1, 2))
    order = sorted(range(r), key=lambda k: (k < linear, -strength[k]))
    return tuple(names[k] for k in order), np.ascontiguousarray(field[order])


def motion_words(group: Group) -> list[str]:
    """Return the description of each component of a twist of the group, (r,)."""
    turns = [f"turn about {'xyz'[axis - 3]}" for axis in group.axes[group.linear :]]
    shifts = [f"shift along {'xyz'[axis]}" for axis in group.axes[: group.linear]]
    return [
        *(shifts if len(shifts) > 1 else ["shift"] * len(shifts)),
        *(turns if len(turns) > 1 else ["turn"] * len(turns)),
    ]
