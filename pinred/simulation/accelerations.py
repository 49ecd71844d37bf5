"""Accelerations of a motion: the derivative of what it reports, along the flow it follows.

Where a trajectory is at time t, its route says how the reduced state changes, ẏ = f(t, y), and
what velocity v(t, y) there is; v̇ is the derivative of v along (1, ẏ), by central differences of
order 8.  So it is what the route's own equations say, whatever the integrator has made of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..common.arrays import Array
from ..common.errors import InputError
from ..system.state_fields import State
from .trajectory import Trajectory

_WEIGHTS = (4 / 5, -1 / 5, 4 / 105, -1 / 280)  # of v(t + k h) − v(t − k h), over h
_STEP = 0.005  # rad, or part of the robot's size, that the fastest joint or the base moves by
_SHORTER = 0.7  # of the step, for a second look
_OF_A_STEP = 1 / 64  # of the integrator, which follows plans that depend on time


@dataclass(frozen=True)
class Accelerations:
    """States at times and their accelerations.

    states: at (T,) times.  v, a: (T, n) velocity and acceleration, body twist and shape.
    spread: (T, n) how far accelerations by two lengths of difference are apart, which is what
    round-off in v makes of them.  pace: (T,) how fast shape and attitude change, slides in parts
    of the robot's size, or plans at times that differ by less [1/s]: round-off of a is that of
    v, times this.
    """

    states: State
    v: Array
    a: Array
    spread: Array
    pace: Array


def accelerations(traj: Trajectory, t: Array, size: float) -> Accelerations:
    """Return states and accelerations at times t (T,).

    size: of the robot [m].  Raises InputError if the base is not among the outputs.
    """
    motion, system = traj.motion, traj.system
    states = motion.states(t)
    if not isinstance(states, State):
        raise InputError("accelerations need the base, which outputs='shape' leaves out")
    v = np.hstack([states.xi, states.xdot])
    # Velocities are linear in momenta: what bends them is the shape and the attitude alone, and
    # not how fast a wheel turns, of whose angle nothing depends.
    units = np.ones(system.n)
    units[: system.group.linear] = 0.0
    units[system.r :][[unit == "m" for unit in system.units]] = 1.0 / size
    units[system.r :][list(traj.plan.acting.cyclic)] = 0.0
    pace = np.abs(v) @ units
    h = np.divide(_STEP, pace, out=np.ones(len(t)), where=pace > 0.0)
    if traj.plan.acting.driven:
        knots = motion.knots
        last = np.clip(np.searchsorted(knots, t), 1, len(knots) - 1)
        h = np.minimum(h, _OF_A_STEP * (knots[last] - knots[last - 1]))
        # A plan that turns round is slow there, and bends all the same.
        h = np.minimum(h, _STEP / max(_pace_of_plans(traj, t), 1e-300))
        pace = np.maximum(pace, _STEP / h)
    changes = motion.changes(t)

    def derivative(h: Array) -> Array:
        a = np.zeros_like(v)
        for k, weight in enumerate(_WEIGHTS, start=1):
            later, before = (motion.beside(t, changes, sign * k * h) for sign in (1.0, -1.0))
            a += (weight / h)[:, None] * (later - before)
        return a

    a = derivative(h)
    return Accelerations(states, v, a, np.abs(a - derivative(_SHORTER * h)), pace)


def _pace_of_plans(traj: Trajectory, t: Array) -> float:
    """Return how fast the rates of prescribed joints change, |ẍ| / |ẋ| of a motion [1/s]."""
    forces, numbers = traj.plan.forces, traj.motion.numbers(t)
    assert forces is not None
    plans = [forces.prescribed(at, row) for at, row in zip(t.tolist(), numbers, strict=True)]
    rates, bends = (np.abs([getattr(each, name) for each in plans]) for name in ("xdot", "xddot"))
    fastest = rates.max(axis=0)
    return float(
        np.divide(bends.max(axis=0), fastest, out=0.0 * fastest, where=fastest > 0.0).max()
    )
