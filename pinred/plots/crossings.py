"""A motion between its report times, and when it crosses a section of its state space."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..arrays import Array
from ..trajectory import Trajectory

_PARTS = 8  # in which each step of the integrator is searched for a change of sign
_HALVINGS = 64  # enough to bring any step down to the spacing of floats


def fine_times(traj: Trajectory) -> Array:
    """Return times from start to end between which a motion turns little, (T,) [s]."""
    ends = np.append(traj.motion.knots, [0.0, traj.scene.end])
    knots = np.unique(np.clip(ends, 0.0, traj.scene.end))
    parts = np.arange(_PARTS) / _PARTS
    return np.append((knots[:-1, None] + parts * np.diff(knots)[:, None]).ravel(), knots[-1])


def crossings(traj: Trajectory, function: Callable[[Array], Array]) -> Array:
    """Return the times at which a function of time changes its sign, (K,) [s].

    function: from times (T,) to values (T,), continuous.  The times are bisected to round-off on
    the dense output.  Two crossings within an eighth of a step of the integrator are not seen.
    """
    t = fine_times(traj)
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
