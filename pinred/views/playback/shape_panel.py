"""The shape panel: the path in shape space, on a field of the connection's curvature."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...analysis.full_reduction import Reduction
from ...common.arrays import Array, freeze
from ...common.errors import InputError
from ...system.system import System

_FINE = 61  # shapes along each axis of the field
_MARGIN = 0.15  # of the path's range, around it
_TURN = 2.0 * np.pi
_LEAST = 0.2  # rad | m; a field narrower than that shows nothing


@dataclass(frozen=True)
class ShapePanel:
    """A path in the plane of two coordinates; arrays are read-only.

    labels: of the axes, with units.  path: (F, 2).  low, high: (2,) the range shown.
    components: names of the components of the curvature B_αβ, with units.  field:
    (components, N, N) over a (first) and b, the other joints held as at the first frame.
    Without a second joint the second axis is the rate of the first, and there is no field;
    nor is there one where a joint makes so many turns that its waves would be too fine.
    """

    labels: tuple[str, str]
    path: Array
    low: Array
    high: Array
    components: tuple[str, ...]
    field: Array

    def __post_init__(self) -> None:
        freeze(self)


def shape_panel(
    system: System, x: Array, xdot: Array, pair: tuple[str, str] | None = None
) -> ShapePanel | None:
    """Return the panel of shapes x and rates xdot, (F, m); None for a rigid body.

    pair: the joints on the axes; if None the two that move the most, but do not spin if possible.
    Raises InputError for joints that there are not.
    """
    names, units = system.shape_names, system.units
    for name in pair or ():
        if name not in names:
            raise InputError(f"pair: no joint '{name}'; the joints are {', '.join(names)}")
    if not system.m:
        return None
    if system.m == 1:
        labels = (f"{names[0]} [{units[0]}]", f"rate of {names[0]} [{units[0]}/s]")
        path = np.column_stack([x[:, 0], xdot[:, 0]])
        return ShapePanel(labels, path, *_range(path), (), np.empty((0, 0, 0)))
    if pair is None:
        moved = np.ptp(x, axis=0)
        spins = (moved > _TURN) & np.array([unit == "rad" for unit in units])
        a, b = sorted(map(int, np.lexsort((-moved, spins))[:2]))
    else:
        a, b = names.index(pair[0]), names.index(pair[1])
    path = x[:, [a, b]]
    low, high = _range(path)
    labels = (f"{names[a]} [{units[a]}]", f"{names[b]} [{units[b]}]")
    if (high - low)[[units[k] == "rad" for k in (a, b)]].max(initial=0.0) > _FINE / 12 * _TURN:
        return ShapePanel(labels, path, low, high, (), np.empty((0, 0, 0)))
    shapes = np.broadcast_to(x[0], (_FINE, _FINE, system.m)).copy()
    shapes[..., a] = np.linspace(low[0], high[0], _FINE)[:, None]
    shapes[..., b] = np.linspace(low[1], high[1], _FINE)[None, :]
    field = np.moveaxis(Reduction(system).grid(shapes).curvature[..., a, b], -1, 0)
    components = _strongest_first(system, field, f"({units[a]}·{units[b]})")
    return ShapePanel(labels, path, low, high, *components)


def _range(path: Array) -> tuple[Array, Array]:
    low, high = path.min(axis=0), path.max(axis=0)
    half = np.maximum((0.5 + _MARGIN) * (high - low), 0.5 * _LEAST)
    return 0.5 * (low + high) - half, 0.5 * (low + high) + half


def _strongest_first(system: System, field: Array, per: str) -> tuple[tuple[str, ...], Array]:
    """Return the components with their names, turns before shifts, the strongest first."""
    axes, linear, r = system.group.axes, system.group.linear, system.r
    turns = [f"turn about {'xyz'[axis - 3]}" for axis in axes[linear:]]
    if len(turns) == 1:
        turns = ["turn"]
    shifts = [f"shift along {'xyz'[axis]}" for axis in axes[:linear]]
    if len(shifts) == 1:
        shifts = ["shift"]
    names = [f"{name} [m/{per}]" for name in shifts] + [f"{name} [rad/{per}]" for name in turns]
    strength = np.abs(field).max(axis=(1, 2))
    order = sorted(range(r), key=lambda k: (k < linear, -strength[k]))
    return tuple(names[k] for k in order), np.ascontiguousarray(field[order])
