"""A motion as a smooth path, whatever times it reports."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from ...common.arrays import Array
from ...common.errors import InputError
from ...simulation.trajectory import Trajectory
from ...system.state_fields import ShapeState, State, map_arrays
from ..motion_source import MotionSource

Path: TypeAlias = State | ShapeState
_PARTS = 8  # in which each step of the integrator is searched for a change of sign


def fine_times(motion: MotionSource) -> Array:
    """Return times from start to end between which a motion turns little, (T,) [s].

    Of a Trajectory they part the integrator's steps, of a Recording its report times.
    """
    knots = motion.t
    if isinstance(motion, Trajectory):
        ends = np.append(motion.motion.knots, [0.0, motion.scene.end])
        knots = np.unique(np.clip(ends, 0.0, motion.scene.end))
    parts = np.arange(_PARTS) / _PARTS
    return np.append((knots[:-1, None] + parts * np.diff(knots)[:, None]).ravel(), knots[-1])


def fine_path(motion: MotionSource) -> Path:
    """Return the states at the report times and, of a Trajectory, close together in between."""
    if not isinstance(motion, Trajectory):
        return motion.outputs
    t, times = motion.t, fine_times(motion)
    return motion.at(np.union1d(t, times[(times >= t[0]) & (times <= t[-1])]))


def state_at(motion: MotionSource, time: float) -> Path:
    """Return the state at a time, of a Recording at the report time that is nearest.

    Raises InputError outside the motion.
    """
    if isinstance(motion, Trajectory):
        return motion.at(time)
    t, out = motion.t, motion.outputs
    if not 0.0 <= time <= t[-1]:
        raise InputError(f"when must lie between 0 and {t[-1]:g} s, got {time}")
    k = int(np.argmin(np.abs(t - time)))
    return map_arrays(lambda values: np.array(values[k]), out)


def shape_path(motion: MotionSource) -> Callable[[Array], tuple[Array, Array]]:
    """Return the function from times (T,) to shapes and rates, (T, m) each.

    Of a Recording it is the cubic of Hermite between report times: of order 4, rates 3.
    """
    if isinstance(motion, Trajectory):

        def dense(t: Array) -> tuple[Array, Array]:
            states = motion.at(t)
            return states.x, states.xdot

        return dense
    if len(motion.t) < 2:
        raise InputError(f"{motion.path} holds one time only, and no path")
    x = CubicHermiteSpline(motion.t, motion.x, motion.xdot)
    xdot = x.derivative()
    return lambda t: (np.asarray(x(t)), np.asarray(xdot(t)))
