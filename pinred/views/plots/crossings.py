"""Times at which a motion crosses a section of its state space."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...common.arrays import Array
from ..motion_source import MotionSource
from .fine_path import fine_times

_HALVINGS = 64  # bisections, enough to reach the spacing of floating-point numbers


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
    # An exact zero takes the sign before it, so that the crossing is counted once.
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
