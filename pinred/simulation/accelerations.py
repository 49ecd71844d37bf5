"""Accelerations of a motion: the derivative of what it reports, along the flow it follows.

Where a trajectory is at time t, its route says how the reduced state changes, ẏ = f(t, y), and
what velocity v(t, y) there is; v̇ is the derivative of v along (1, ẏ), by central differences of
order 8.  So it is what the route's own equations say, whatever the integrator has made of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..common.arrays import Array
from .pieces import Motion
from .state import State

_WEIGHTS = (4 / 5, -1 / 5, 4 / 105, -1 / 280)  # of v(t + k h) − v(t − k h), over h
_STEP = 0.02  # of the time in which the fastest number changes by 1, or by its own size


@dataclass(frozen=True)
class Accelerations:
    """States at times and their accelerations.

    states: at (T,) times.  v, a: (T, n) velocity and acceleration, body twist and shape.
    """

    states: State
    v: Array
    a: Array


def accelerations(motion: Motion, t: Array) -> Accelerations:
    """Return states and accelerations at times t (T,); the base must be among the outputs."""
    states = motion.states(t)
    if not isinstance(states, State):
        raise TypeError("accelerations need the base, which this motion does not report")
    v, changes = np.hstack([states.xi, states.xdot]), motion.changes(t)
    change = np.abs(changes.rates) / np.maximum(1.0, np.abs(changes.y))
    fast = np.maximum(change.max(axis=1, initial=0.0), np.abs(v).max(axis=1, initial=0.0))
    h, a = _STEP / (1.0 + fast), np.zeros_like(v)
    for k, weight in enumerate(_WEIGHTS, start=1):
        later, before = (motion.beside(t, changes, sign * k * h) for sign in (1.0, -1.0))
        a += (weight / h)[:, None] * (later - before)
    return Accelerations(states, v, a)
