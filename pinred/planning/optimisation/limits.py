"""Limits of joints, speeds and torques, and the margins between a gait and these limits."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...analysis.connections.connection import Connection, robot_of
from ...analysis.gaits.gait import Gait
from ...analysis.phases.path_basis import fourier_rows
from ...common.arrays import Array, FrozenArrays, as_floats
from ...common.errors import InputError, ShapeError
from ...common.names import joint_index
from .objective import torque_order, torques

# Limits: r for [−r, r] or a pair (low, high), for all joints or for each joint.  Limits of speed
# and torque are symmetric, so that they accept only r.
LimitsLike: TypeAlias = float | ArrayLike | Mapping[str, ArrayLike]
WHOLE_TURN = 2.0 * np.pi  # default limit of rotational joints in either direction [rad]
# What no plan takes into account, as part of its text.  Speeds and torques have arguments instead.
NOT_CONSIDERED = "velocity and effort limits of the file, collisions between links"
# Default limit of each entry of a ball's rotation vector, which is then shorter than 2π [rad].
BALL_LIMIT = 3.6


def require_two_joints(m: int) -> None:
    """Raise InputError for a single joint, whose loops enclose no area."""
    if m < 2:
        raise InputError(
            "a loop needs two joints: a single joint can only retrace its path. The phase of its "
            "whole turns is phase(connection, Gait.waypoints([x0], turns=[1]))"
        )


@dataclass(frozen=True, eq=False)
class Limits(FrozenArrays):
    """Limits of the joints; an infinite entry means that there is no limit.

    Attributes:
        shape: Lower and upper bound, (m, 2) [rad | m].
        speed: Largest speed, (m,) [rad/s | m/s].
        torque: Largest torque or force, (m,) [N·m | N].
    """

    shape: Array
    speed: Array
    torque: Array

    @property
    def middle(self) -> Array:
        """Centre of the joint ranges, (m,)."""
        return np.asarray(self.shape.mean(axis=1))

    @property
    def reach(self) -> Array:
        """Half width of the joint ranges, (m,)."""
        return np.asarray(0.5 * np.ptp(self.shape, axis=1))


def limits_of(
    connection: Connection,
    shape: LimitsLike | None,
    speed: LimitsLike | None,
    torque: LimitsLike | None,
) -> Limits:
    """Convert options to limits.

    Args:
        connection: The connection.
        shape: Limits of the joints; if None, those of the robot file, or a full turn in
            either direction for rotational joints without a range, or `BALL_LIMIT` for the entries
            of rotation vectors. With a centre, limits are relative to it.
        speed: Limits of the speeds, or None.
        torque: Limits of the torques, or None.
    Returns:
        The limits.
    Raises:
        InputError: A limit is invalid, or the allowed range is empty.
        ShapeError: The number of limits is wrong.
    """
    m = connection.m
    defaults = _file_limits(connection)
    ranges = defaults if shape is None else _by_joint(connection, shape, "limits", defaults)
    for name, (low, high) in zip(connection.joints, ranges, strict=True):
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
            raise InputError(
                f"limits of joint '{name}' must be finite and increase, got [{low:g}, {high:g}]"
            )
    free = np.tile([-np.inf, np.inf], (m, 1))
    speeds = free if speed is None else _by_joint(connection, speed, "speeds", free)
    efforts = free if torque is None else _by_joint(connection, torque, "torques", free)
    return Limits(ranges, speeds[:, 1].copy(), efforts[:, 1].copy())


def _file_limits(connection: Connection) -> Array:
    """Return the joint ranges, (m, 2), in the robot file, or a full turn in either direction."""
    ranges = np.full((connection.m, 2), np.nan)
    for k, unit in enumerate(connection.form.units):
        if unit == "rad":
            ranges[k] = -WHOLE_TURN, WHOLE_TURN
    system, chart = robot_of(connection), connection.chart
    if chart is not None:
        ranges[chart.space.ball_v] = -BALL_LIMIT, BALL_LIMIT
    if system is not None:
        joints = dict(zip(system.shape_names, system.joints, strict=True))
        for k, name in enumerate(connection.joints if system.loops else system.shape_names):
            joint = joints[name]
            at = system.model.idx_qs[joint]
            if system.model.nqs[joint] == 1:
                low = float(system.model.lowerPositionLimit[at])
                high = float(system.model.upperPositionLimit[at])
                if np.isfinite([low, high]).all() and max(-low, high) < 1e6 and low < high:
                    ranges[k] = low, high
    if chart is not None:
        space = chart.space
        ranges[space.scalar_v] -= chart.centre[space.scalar_x, None]
    return ranges


def _by_joint(connection: Connection, limits: LimitsLike, what: str, defaults: Array) -> Array:
    """Return pairs (m, 2) of limits; joints that are not named get `defaults`."""
    m = connection.m
    if isinstance(limits, Mapping):
        ranges = defaults.copy()
        for name, value in limits.items():
            ranges[joint_index(name, list(connection.joints), what)] = _pair(value, what)
        return ranges
    if isinstance(limits, (list, tuple)) and len(limits) == m:  # each a number or a pair
        return np.stack([_pair(entry, what) for entry in limits])
    array = as_floats(limits, what)
    if array.ndim == 0:
        return np.tile(_pair(array, what), (m, 1))
    if array.shape == (m,) or (what == "limits" and array.shape == (m, 2)):
        return np.stack([_pair(entry, what) for entry in array])
    raise ShapeError(
        f"{what} must be a number, one for each of {m} joints, or {{joint: limit}}"
        f"{', or pairs (m, 2)' if what == 'limits' else ''}; got shape {array.shape}"
    )


def _pair(value: ArrayLike, what: str) -> Array:
    array = as_floats(value, what)
    if array.shape == (2,) and what == "limits":
        return array
    if array.ndim or not array > 0.0:
        raise InputError(f"{what} of a joint must be above zero, or a pair, got {value!r}")
    return np.array([-float(array), float(array)])


_POINTS = 9  # number of points of the local grid
_ROUNDS = 10  # number of refinements; each refines the grid by a factor of four


def find_peaks(
    values: Callable[[Array], Array], s: Array, level: Array | float
) -> tuple[NDArray[np.int_], Array, Array]:
    """Find the local maxima of |f| above a level for m functions f, including between samples.

    Args:
        values: Vectorised functions f: s (N,) → (N, m).
        s: Equidistant samples, (N,), fine enough that three consecutive samples enclose at most one
            maximum.  Maxima at the first and the last sample are not included.
        level: The level, or one for each function, (m,).
    Returns:
        Indices of the functions, positions and absolute values of the maxima, (K,) each.
    """
    size = np.abs(values(s))
    inner, before, after = size[1:-1], size[:-2], size[2:]
    # A parabola through three samples exceeds the middle one by less than both differences.
    bound = inner + np.abs(after - before) + np.abs(after - 2.0 * inner + before)
    sample, column = np.nonzero((inner >= before) & (inner >= after) & (bound > level))
    position, peak = s[1 + sample], inner[sample, column]
    step, offsets, row = s[1] - s[0], np.linspace(-1.0, 1.0, _POINTS), np.arange(len(sample))
    for _ in range(_ROUNDS if len(sample) else 0):
        points = position[:, None] + step * offsets
        at_points = np.abs(values(points.ravel())).reshape(*points.shape, -1)
        at_points = at_points[row, :, column]
        best = at_points.argmax(axis=1)
        position, peak = points[row, best], at_points[row, best]
        step *= 2.0 / (_POINTS - 1)
    above = peak > np.broadcast_to(level, size.shape[1:])[column]
    return column[above], position[above], peak[above]


def find_extremes(values: Callable[[Array], Array], s: Array) -> tuple[Array, Array]:
    """Find the maxima of the absolute values of m functions, including between samples.

    Args:
        values: Vectorised functions: s (N,) → (N, m).  They must be defined one sample interval
            beyond both ends.
        s: Equidistant samples, (N,); see `find_peaks`.
    Returns:
        Positions, (m,), and absolute values, (m,), of the maxima.
    """
    size = np.abs(values(s))
    position, extreme = s[size.argmax(axis=0)], size.max(axis=0)
    step = s[1] - s[0]
    column, peaks, sizes = find_peaks(values, np.hstack([s[0] - step, s, s[-1] + step]), extreme)
    for k in np.argsort(sizes):  # the largest one last
        position[column[k]], extreme[column[k]] = peaks[k], sizes[k]
    return position, extreme


_TIMES = 1024  # smallest number of torque samples in a cycle
_PER_HARMONIC = 64  # number of torque samples per harmonic
_ACTIVE = 1e-6  # margin below which a limit is active, relative to the smallest limit of its kind


def margins(connection: Connection, gait: Gait, limits: Limits) -> dict[str, float]:
    """Compute the smallest distance to the limits of each kind.

    Args:
        connection: The connection.
        gait: The gait.
        limits: The limits.
    Returns:
        Distances in joint units by kind ("limits", "speeds", "torques"), negative beyond a limit;
        kinds without limits are omitted.
    """
    ranges = gait.limits
    distances = {
        "limits": float(
            np.minimum(ranges[:, 0] - limits.shape[:, 0], limits.shape[:, 1] - ranges[:, 1]).min()
        )
    }
    if np.isfinite(limits.speed).any():
        distances["speeds"] = float((limits.speed - peak_speeds(gait)).min())
    if np.isfinite(limits.torque).any():
        distances["torques"] = float((limits.torque - peak_torques(connection, gait)[1]).min())
    return distances


def active_limits(limits: Limits, margins: Mapping[str, float]) -> tuple[str, ...]:
    """Return the kinds of limits that a gait reaches, or exceeds.

    Args:
        limits: The limits.
        margins: Smallest distance to the limits of each kind; see `margins`.
    Returns:
        The kinds, of "limits", "speeds" and "torques".
    """
    sizes = {"limits": limits.reach, "speeds": limits.speed, "torques": limits.torque}
    return tuple(
        kind for kind, margin in margins.items() if not margin > _ACTIVE * sizes[kind].min()
    )


def peak_speeds(gait: Gait) -> Array:
    """Return the largest speed of each joint, (m,)."""
    if gait.is_smooth:
        return np.asarray(np.abs(_rate_gait(gait).limits).max(axis=1))
    return np.asarray(np.abs(gait.samples(_TIMES)[1]).max(axis=0))


def _rate_gait(gait: Gait) -> Gait:
    """Return the joint rates ẋ(t) of a Fourier gait as another Fourier gait."""
    arc = gait.series
    k = np.arange(1, len(arc.cos) + 1)[:, None] * ((arc.end - arc.start) / gait.period)
    return Gait((replace(arc, mean=0.0 * arc.mean, cos=k * arc.sin, sin=-k * arc.cos),))


def torque_samples(harmonics: int) -> Array:
    """Return times s = t/T in [0, 1), (N,), at which torques are sampled to find their peaks."""
    count = max(_TIMES, _PER_HARMONIC * harmonics)
    return np.arange(count) / count


def peak_torques(connection: Connection, gait: Gait) -> tuple[Array, Array]:
    """Compute the largest torque of each joint of a Fourier gait.

    Args:
        connection: The connection, defined by zero momentum or by drag.
        gait: The gait.
    Returns:
        The times s = t/T of the maxima, (m,), and the torques, (m,) [N·m | N].
    Raises:
        InputError: The gait is not one Fourier series.
    """
    arc = gait.series
    turn = arc.end - arc.start
    coefficients = np.vstack([arc.mean[None], arc.cos, arc.sin])

    def tau(s: Array) -> Array:
        rows = fourier_rows(len(arc.cos), s, start=arc.start, turn=turn)
        return torques(connection, *(row @ coefficients for row in rows))

    s, peaks = find_extremes(tau, torque_samples(len(arc.cos)))
    return s % 1.0, peaks / gait.period ** torque_order(connection)
