"""Limits of joints, speeds and torques: margins of a gait, and constraints at check times.

A limited quantity q of a joint is scaled so that its limits are −1 ≤ q ≤ 1.  A check is the
constraint ±q(s) ≤ 1 at a fixed time s.  In contrast to a moving extreme, it is a smooth function of
the loop, also where two extremes merge to a flat top.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...analysis.connections.connection import Connection, robot_of
from ...analysis.phases.gait import Gait, stationary_angles
from ...analysis.phases.lift import fourier_rows
from ...common.arrays import Array, FrozenArrays, as_floats
from ...common.errors import InputError, ShapeError
from ...common.names import joint_index
from .objective import torque_order, torque_slopes, torques

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
    if not gait.is_smooth:
        return np.asarray(np.abs(gait.samples(_TIMES)[1]).max(axis=0))
    arc = gait.series  # its rates ẋ(t) are another Fourier series
    k = np.arange(1, len(arc.cos) + 1)[:, None] * ((arc.end - arc.start) / gait.period)
    rates = Gait((replace(arc, mean=0.0 * arc.mean, cos=k * arc.sin, sin=-k * arc.cos),))
    return np.asarray(np.abs(rates.limits).max(axis=1))


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


_CHECKS_PER_HARMONIC = 8  # initial checks per harmonic and period, of each quantity and sign
# Further checks around a peak that exceeds its limit, as parts of the time to the next check.
_CLOSER = 2.0 ** -np.array([1.0, 3.0, 5.0])
_TORQUE = 2  # kind of quantity; kinds 0 and 1 are shapes and speeds
_ROUND_OFF = 1e-9  # distance to its limit below which a peak counts as beyond it
_FLAT = 1e-6  # relative bend below which a minimum may be a maximum by round-off


class Times(NamedTuple):
    """Times at which quantities are limited.

    Attributes:
        kind: Limited quantity: 0 shape, 1 speed, 2 torque, (N,).
        joint: Index of the joint, (N,).
        sign: +1 for the upper limit, −1 for the lower one, (N,).
        s: Time s = t/T, (N,).
    """

    kind: NDArray[np.int_]
    joint: NDArray[np.int_]
    sign: Array
    s: Array


class CheckGroup(NamedTuple):
    """Checks of one kind of quantity, whose values q are those of M joints and times.

    Attributes:
        kind: Limited quantity: 0 shape, 1 speed, 2 torque.
        at: Indices of the checks, (N,).
        joint: Indices of the joints, (M,).
        s: Times, (M,).
        pair: Index of joint and time of each check, (N,).
    """

    kind: int
    at: NDArray[np.int_]
    joint: NDArray[np.int_]
    s: Array
    pair: NDArray[np.int_]


@dataclass(frozen=True, eq=False)
class LimitChecks:
    """Checks that move with a loop which is shifted along itself, x(s) → x(s + shift).

    Otherwise a loop could gain by a shift of its peaks to times between checks.

    Attributes:
        times: Times of the checks.
        loop: Loop for which these times hold, (K, m).
        shifts: Derivative of the shift with respect to the coefficients, (K, m).
    """

    times: Times
    loop: Array
    shifts: Array

    @cached_property
    def groups(self) -> tuple[CheckGroup, ...]:
        """The checks of each kind of quantity."""
        groups = []
        for kind in np.unique(self.times.kind).tolist():
            at = np.flatnonzero(self.times.kind == kind)
            pairs = np.stack([self.times.joint[at], self.times.s[at]])
            # Both signs of a quantity share its evaluation.
            (joint, s), index = np.unique(pairs, axis=1, return_inverse=True)
            groups.append(CheckGroup(kind, at, joint.astype(int), s, index))
        return tuple(groups)

    def shift(self, c: Array) -> float:
        """Return the shift of a loop along itself, relative to the loop of the checks."""
        return float((self.shifts * (c - self.loop)).sum())

    def refined(self, beyond: Times, c: Array) -> LimitChecks:
        """Return the checks for a loop, and more between those around its peaks beyond limits.

        Args:
            beyond: The peaks.
            c: Coefficients of the loop, (K, m).
        Returns:
            The checks, whose times move with the loop.
        """
        kinds, joints, signs, moments = self.times._replace(s=self.times.s + self.shift(c))
        more = [Times(kinds, joints, signs, moments % 1.0)]
        for kind, joint, sign, s in zip(*beyond, strict=True):
            same = (kinds == kind) & (joints == joint) & (signs == sign)
            distances = (moments[same] - s) % 1.0
            between = np.outer([distances.max() - 1.0, distances.min()], _CLOSER)
            between = np.append(between, 0.0)
            more.append(Times(*np.broadcast_arrays(kind, joint, sign, (s + between) % 1.0)))
        times = Times(*(np.concatenate(column) for column in zip(*more, strict=True)))
        k = 2.0 * np.pi * np.arange(1, (len(c) + 1) // 2)[:, None]
        cos, sin = np.split(c[1:], 2)
        by_shift = np.vstack([np.zeros_like(c[:1]), k * -sin, k * cos])
        return LimitChecks(times, c, by_shift / (by_shift**2).sum())


def first_checks(limits: Limits, harmonics: int) -> LimitChecks:
    """Return checks of all limited quantities at equal distances.

    Args:
        limits: The limits.
        harmonics: Number of harmonics of the loop.
    Returns:
        The checks, whose times are fixed.
    """
    count = _CHECKS_PER_HARMONIC * (harmonics + 1)
    kind, joint = np.nonzero(np.isfinite([limits.reach, limits.speed, limits.torque]))
    quantity, sign, k = (index.ravel() for index in np.indices((len(kind), 2, count)))
    times = Times(kind[quantity], joint[quantity], 1.0 - 2.0 * sign, k / count)
    still = np.zeros((1 + 2 * harmonics, len(limits.reach)))
    return LimitChecks(times, still, still)


class CheckedValues(NamedTuple):
    """Values ±q of checks with derivatives.

    Attributes:
        values: Values, (N,).
        by_c: Derivatives with respect to the path coefficients, (N, K, m).
        by_log_period: Derivatives with respect to the logarithm of the period, (N,).
    """

    values: Array
    by_c: Array
    by_log_period: Array


@dataclass(frozen=True, eq=False)
class LimitedLoop:
    """A Fourier loop with the limits of its quantities.

    Attributes:
        connection: The connection.
        limits: The limits.
        c: Coefficients of the loop: mean, cosines and sines, (K, m).
        period: Period T [s].
    """

    connection: Connection
    limits: Limits
    c: Array
    period: float

    @property
    def harmonics(self) -> int:
        """Number of harmonics."""
        return (len(self.c) - 1) // 2

    def order(self, kind: int) -> int:
        """Return the power of 1/T with which a kind of quantity scales."""
        return torque_order(self.connection) if kind == _TORQUE else kind

    def scale(self, kind: int) -> Array:
        """Return the limits of a kind of quantity for period 1, (m,)."""
        size = (self.limits.reach, self.limits.speed, self.limits.torque)[kind]
        return np.asarray(size * self.period ** self.order(kind))

    def scaled(self, kind: int, s: Array) -> Array:
        """Return the quantities q of one kind at times s (N,), (N, m)."""
        states = [rows @ self.c for rows in fourier_rows(self.harmonics, s)]
        q = torques(self.connection, *states) if kind == _TORQUE else states[kind]
        return np.asarray((q - self.limits.middle * (kind == 0)) / self.scale(kind))

    def values(self, checks: LimitChecks) -> CheckedValues:
        """Compute the values of checks and their derivatives."""
        signs, count = checks.times.sign, len(checks.times.s)
        values, by_c, order = np.zeros(count), np.zeros((count, *self.c.shape)), np.zeros(count)
        for group in checks.groups:
            q, q_by_c = self._with_slopes(group, checks)
            sign = signs[group.at]
            values[group.at] = sign * q[group.pair]
            by_c[group.at] = sign[:, None, None] * q_by_c[group.pair]
            order[group.at] = self.order(group.kind)
        return CheckedValues(values, by_c, -order * values)

    def _with_slopes(self, group: CheckGroup, checks: LimitChecks) -> tuple[Array, Array]:
        """Return q, (M,), and its derivatives, (M, K, m), at times that move with the loop."""
        kind, joint, s = group.kind, group.joint, group.s + checks.shift(self.c)
        samples, scale = np.arange(len(s)), self.scale(kind)[joint]
        rows = fourier_rows(self.harmonics, s)
        x, slope, bend = states = [row @ self.c for row in rows]
        covector = np.zeros((len(s), self.c.shape[1]))
        covector[samples, joint] = 1.0 / scale
        if kind == _TORQUE:
            q = torques(self.connection, x, slope, bend)[samples, joint]
            slopes = dict(
                enumerate(
                    np.split(torque_slopes(self.connection, x, slope, bend, covector), 3, axis=1)
                )
            )
        else:
            q, slopes = states[kind][samples, joint], {kind: covector}
            q = q - self.limits.middle[joint] * (kind == 0)
        rates = (*states[1:], self.third_derivatives(rows[1]))
        by_c = sum(rows[k][:, :, None] * by_state[:, None] for k, by_state in slopes.items())
        rate = sum((by_state * rates[k]).sum(axis=1) for k, by_state in slopes.items())
        return q / scale, np.asarray(by_c + np.multiply.outer(rate, checks.shifts))

    def third_derivatives(self, slope_rows: Array) -> Array:
        """Return x‴, (N, m), from the rows of first derivatives."""
        k = 2.0 * np.pi * np.arange(1.0, self.harmonics + 1.0)
        return np.asarray(slope_rows @ (-(np.concatenate([[0.0], k, k])[:, None] ** 2) * self.c))

    def peaks_beyond(self, level: float = 1.0 - _ROUND_OFF) -> Times:
        """Return the local maxima of |q| that exceed a level."""
        times = [Times(*(np.zeros(0, dtype) for dtype in (int, int, float, float)))]
        for kind, size in enumerate((self.limits.reach, self.limits.speed, self.limits.torque)):
            if not np.isfinite(size).any():
                continue
            if kind == _TORQUE:
                s = torque_samples(self.harmonics)
                q = partial(self.scaled, kind)
                joint, s, _ = find_peaks(q, np.hstack([s[-1] - 1.0, s, 1.0]), level)
                value = q(s)[np.arange(len(s)), joint]
            else:
                joint, s, value = self._stationary(kind)
            beyond = np.abs(value) > level
            kinds = np.full(beyond.sum(), kind)
            times.append(Times(kinds, joint[beyond], np.sign(value[beyond]), s[beyond] % 1.0))
        return Times(*(np.concatenate(column) for column in zip(*times, strict=True)))

    def _stationary(self, kind: int) -> tuple[NDArray[np.int_], Array, Array]:
        """Return joints, times and values q of the maxima of |shape| or |speed|, (N,) each.

        Minima are omitted, unless they almost coincide with a maximum at a flat top.
        """
        k = 2.0 * np.pi * np.arange(1, self.harmonics + 1)[:, None]
        mean, cos, sin = self.c[0] - self.limits.middle, *np.split(self.c[1:], 2)
        if kind:
            mean, cos, sin = 0.0 * mean, k * sin, -k * cos
        joints, angles, values = [], [], []
        for j, wave in enumerate((cos - 1j * sin).T / self.scale(kind)[:, None]):
            angle = stationary_angles(wave.real, -wave.imag)
            turns = np.exp(1j * np.outer(angle, np.arange(1, self.harmonics + 1)))
            value = mean[j] / self.scale(kind)[j] + (turns @ wave).real
            bends = k[:, 0] ** 2 * wave
            maximum = np.sign(value) * (turns @ bends).real > -_FLAT * np.abs(bends).sum()
            joints.append(np.full(maximum.sum(), j))
            angles.append(angle[maximum])
            values.append(value[maximum])
        times = np.concatenate(angles) / (2.0 * np.pi)
        return np.concatenate(joints), times, np.concatenate(values)
