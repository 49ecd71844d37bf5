"""Limits of a Fourier loop as constraints at check times, which peaks beyond a limit extend.

A limited quantity q of a joint is scaled so that its limits are −1 ≤ q ≤ 1.  A check is the
constraint ±q(s) ≤ 1 at a fixed time s.  In contrast to a moving extreme, it is a smooth function of
the loop, also where two extremes merge to a flat top.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...analysis.connections.connection import Connection
from ...analysis.gaits.arcs import stationary_angles
from ...analysis.phases.path_basis import fourier_rows
from ...common.arrays import Array
from .limits import Limits, find_peaks, torque_samples
from .objective import torque_order, torque_slopes, torques

_PER_HARMONIC = 8  # initial checks per harmonic and period, of each quantity and sign
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
    count = _PER_HARMONIC * (harmonics + 1)
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
