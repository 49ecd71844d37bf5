"""Accelerations along a trajectory, from the equations of the engine that computed it.

At time t the engine gives the rate of the reduced state, ẏ = f(t, y), and the velocity v(t, y).
The acceleration v̇ is the derivative of v along (1, ẏ), by central differences of order 8.  It
therefore follows from the equations alone, and is independent of the integrator.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..common.arrays import Array
from ..common.errors import InputError
from ..system.state_fields import State
from .trajectory import Trajectory

# Weights of v(t + k h) − v(t − k h), k = 1, …, 4, in the central difference times h.
_WEIGHTS = (4 / 5, -1 / 5, 4 / 105, -1 / 280)
# Motion of the fastest joint or of the base within h [rad, or fraction of the robot's size].
_STEP = 0.005
_SHORTER = 0.7  # Factor of h in the second estimate, which shows the round-off.
# Largest h in integrator steps if prescribed joints depend on time.
_FRACTION_OF_STEP = 1 / 64


@dataclass(frozen=True)
class Accelerations:
    """States and accelerations at some times.

    Attributes:
        states: States at the times (T,).
        v: Body twist and shape rate, (T, n).
        a: Their derivatives, (T, n).
        spread: Difference between the accelerations for two lengths h, (T, n); it measures the
            round-off of v.
        pace: Rate at which shape and attitude change, slides in units of the robot's size, (T,)
            [1/s].  It is larger if prescribed joints need shorter differences.  The round-off of a
            is that of v times this rate.
    """

    states: State
    v: Array
    a: Array
    spread: Array
    pace: Array


def accelerations(traj: Trajectory, t: Array, size: float) -> Accelerations:
    """Compute states and accelerations of a trajectory.

    Args:
        traj: The trajectory.
        t: Times, (T,) [s].
        size: Length of the robot [m].
    Returns:
        States and accelerations at the times.
    Raises:
        InputError: The scene leaves out the base.
    """
    motion, system = traj.motion, traj.system
    states = motion.states(t)
    if not isinstance(states, State):
        raise InputError("accelerations need the base, which outputs='shape' leaves out")
    v = np.hstack([states.xi, states.xdot])
    # v is linear in the momenta, so only the motion of shape and attitude limits h.  Cyclic joints
    # do not count, because nothing depends on their angles.
    units = np.ones(system.n)
    units[: system.group.linear] = 0.0
    units[system.r :][[unit == "m" for unit in system.units]] = 1.0 / size
    units[system.r :][list(traj.plan.acting.cyclic)] = 0.0
    pace = np.abs(v) @ units
    h = np.divide(_STEP, pace, out=np.ones(len(t)), where=pace > 0.0)
    if traj.plan.acting.driven:
        step_ends = motion.knots
        last = np.clip(np.searchsorted(step_ends, t), 1, len(step_ends) - 1)
        h = np.minimum(h, _FRACTION_OF_STEP * (step_ends[last] - step_ends[last - 1]))
        # A prescribed joint that reverses is slow, but its acceleration is large.
        h = np.minimum(h, _STEP / max(_prescribed_pace(traj, t), 1e-300))
        pace = np.maximum(pace, _STEP / h)
    changes = motion.changes(t)

    def differentiate(h: Array) -> Array:
        a = np.zeros_like(v)
        for k, weight in enumerate(_WEIGHTS, start=1):
            after, before = (motion.beside(t, changes, sign * k * h) for sign in (1.0, -1.0))
            a += (weight / h)[:, None] * (after - before)
        return a

    a = differentiate(h)
    return Accelerations(states, v, a, np.abs(a - differentiate(_SHORTER * h)), pace)


def _prescribed_pace(traj: Trajectory, t: Array) -> float:
    """Return the largest ratio of |ẍ| to |ẋ| of the prescribed joints at times t [1/s]."""
    forces, numbers = traj.plan.forces, traj.motion.numbers(t)
    assert forces is not None
    plans = [
        forces.prescribed(time, values) for time, values in zip(t.tolist(), numbers, strict=True)
    ]
    speeds = np.abs([plan.xdot for plan in plans]).max(axis=0)
    accelerations = np.abs([plan.xddot for plan in plans]).max(axis=0)
    return float(np.divide(accelerations, speeds, out=0.0 * speeds, where=speeds > 0.0).max())
