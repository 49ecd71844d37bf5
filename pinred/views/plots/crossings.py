"""When a motion crosses a section of its state space."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...common.arrays import Array
from ..motion_source import MotionSource
from .fine_path import fine_times

_HALVINGS = 64  # enough to bring any step down to the spacing of floats


def crossings(motion: MotionSource, function: Callable[[Array], Array]) -> Array:
    """Return the times at which a function of time changes its sign, (K,) [s].

    function: from times (T,) to values (T,), continuous.  The times are bisected to round-off.
    Two crossings within an eighth of a step of the integrator, or of a file's, are not seen.
    """
    t = fine_times(motion)
    # A zero counts as the sign before it, so that one hit exactly is found once.
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
