"""Closed paths of arcs: check of closure, and winding number."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...common.arrays import Array
from ...common.errors import InputError
from .arcs import TAU, Arc

_CLOSED = 1e-9  # largest gap between arcs, relative to the size of the path
_STEP = 0.05  # largest angle about the centre between two samples [turns]


def check_joined(arcs: Sequence[Arc], rise: Array) -> None:
    """Check that each arc ends where the next one starts, and that the last closes the path.

    Args:
        arcs: Arcs in order.
        rise: Change of the shape per cycle by complete turns, (m,) [rad].
    Raises:
        InputError: There is a gap, or a number is not finite.
    """
    ends = [arc.at(np.array([0.0, 1.0]))[0] for arc in arcs]
    if not all(np.isfinite(end).all() for end in ends):
        raise InputError("arcs: all coefficients of a gait must be finite")
    size = max(1.0, *(float(np.abs(end).max(initial=0.0)) for end in ends))
    starts = [*(end[0] for end in ends[1:]), ends[0][0] + rise]
    for k, (end, following) in enumerate(zip(ends, starts, strict=True)):
        gap = float(np.abs(following - end[1]).max(initial=0.0))
        if gap > _CLOSED * size:
            where = "it does not close" if k + 1 == len(ends) else f"it jumps after arc {k}"
            raise InputError(f"a gait is a closed path, but {where}: from {end[1]} to {following}")


def winding_number(arcs: Sequence[Arc], joints: Sequence[int], centre: Array) -> float:
    """Count the windings of a closed path around a centre in the plane of two joints.

    Args:
        arcs: Arcs in order.
        joints: Indices of the two joints.
        centre: Centre, (2,).
    Returns:
        The winding number, positive from the axis of the first joint to that of the second.
    Raises:
        InputError: The path passes through the centre, or too close to it.
    """
    count = 64
    while count <= 2**16:
        s = np.linspace(0.0, 1.0, count + 1)
        arms = np.concatenate([arc.at(s)[0][:, joints] for arc in arcs]) - centre
        if not np.hypot(*arms.T).min() > 1e-9:
            raise InputError(
                f"the gait passes through the centre {centre}, so its winding number is "
                "undefined. Choose another centre"
            )
        steps = np.diff(np.unwrap(np.arctan2(arms[:, 1], arms[:, 0])))
        if np.abs(steps).max() < _STEP * TAU:
            return float(round(steps.sum() / TAU))
        count *= 4
    raise InputError(
        f"the gait passes too close to the centre {centre} to count its windings. "
        "Choose another centre"
    )
