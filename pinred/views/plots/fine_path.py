"""Motions on fine time grids, independent of their report times."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from ...common.arrays import Array
from ...common.errors import InputError
from ...simulation.trajectory import Trajectory
from ...system.state_fields import ShapeState, State, map_arrays
from ..motion_source import MotionSource

Path: TypeAlias = State | ShapeState
_PARTS = 8  # number of subdivisions of each integration step


def fine_times(motion: MotionSource) -> Array:
    """Return a fine time grid from start to end, (T,) [s].

    The grid subdivides the integration steps of a Trajectory, or the report intervals of a
    recording.
    """
    knots = motion.t
    if isinstance(motion, Trajectory):
        ends = np.append(motion.motion.knots, [0.0, motion.scene.end])
        knots = np.unique(np.clip(ends, 0.0, motion.scene.end))
    offsets = np.arange(_PARTS) / _PARTS
    return np.append((knots[:-1, None] + offsets * np.diff(knots)[:, None]).ravel(), knots[-1])


def fine_path(motion: MotionSource) -> Path:
    """Return the states at the report times and, for a Trajectory, on the fine time grid."""
    if not isinstance(motion, Trajectory):
        return motion.outputs
    t, times = motion.t, fine_times(motion)
    return motion.at(np.union1d(t, times[(times >= t[0]) & (times <= t[-1])]))


def charted_path(motion: MotionSource) -> Path:
    """Return fine_path with a coordinate for each rate, and the derivatives of these coordinates.

    Balls have rotation vectors.  LoadError if a recording has balls and its robot is not found.
    """
    path = fine_path(motion)
    if path.x.shape[-1] == path.xdot.shape[-1]:
        return path
    space = motion.system.space
    w = space.chart(path.x)
    return replace(path, x=w, xdot=space.chart_rate(w, path.xdot))


def state_at(motion: MotionSource, time: float) -> Path:
    """Return the state at a time, or at the nearest report time of a recording.

    Args:
        motion: The motion.
        time: Time [s].
    Raises:
        InputError: The time is outside the motion.
    """
    if isinstance(motion, Trajectory):
        return motion.at(time)
    t, states = motion.t, motion.outputs
    if not 0.0 <= time <= t[-1]:
        raise InputError(f"when must lie between 0 and {t[-1]:g} s, got {time}")
    k = int(np.argmin(np.abs(t - time)))
    return map_arrays(lambda values: np.array(values[k]), states)


def shape_path(motion: MotionSource) -> Callable[[Array], tuple[Array, Array]]:
    """Return the function from times (T,) to coordinates and their derivatives, (T, m) each.

    A recording is interpolated with cubic Hermite splines (shapes have order 4, rates order 3).

    Args:
        motion: The motion.
    Raises:
        InputError: A recording with a single time has no path.
    """
    if len(motion.t) < 2 and not isinstance(motion, Trajectory):
        raise InputError(f"{motion.path} contains only one time, so it has no path")
    path = charted_path(motion)
    if isinstance(motion, Trajectory):
        space = motion.system.space

        def dense(t: Array) -> tuple[Array, Array]:
            states = motion.at(t)
            near = np.clip(np.searchsorted(path.t, t), 0, len(path.t) - 1)
            w = space.chart(states.x, near=path.x[near])
            return w, space.chart_rate(w, states.xdot)

        return dense
    x = CubicHermiteSpline(motion.t, path.x, path.xdot)
    xdot = x.derivative()
    return lambda t: (np.asarray(x(t)), np.asarray(xdot(t)))
