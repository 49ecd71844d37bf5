"""Margins of a gait to its limits, at its true extremes."""

from __future__ import annotations

import numpy as np

from ...analysis.connections.connection import Connection
from ...analysis.gaits.arcs import FourierArc
from ...analysis.gaits.gait import Gait
from ...analysis.phases.path_basis import fourier_rows
from ...common.arrays import Array
from ...common.errors import InputError
from .costs import torque_order, torques
from .extremes import find_extremes
from .limits import Limits

_TIMES = 1024  # smallest number of torque samples in a cycle
_PER_HARMONIC = 64  # torque samples of each harmonic
_OVERCORRECTION = 1.1  # factor on violations by which limits are tightened


def violation_times(connection: Connection, gait: Gait, limits: Limits) -> Array:
    """Find the s = t/T at which a Fourier gait exceeds limits most.

    Args:
        connection: The connection.
        gait: The gait.
        limits: The limits.
    Returns:
        At most one s per joint and kind of limit; empty if no limit is exceeded.
    """
    (arc,) = gait.arcs
    s = arc.extremes()
    x = arc.at(s)[0]
    times = _worst_violations(s, np.maximum(limits.shape[:, 0] - x, x - limits.shape[:, 1]))
    if np.isfinite(limits.speed).any():
        arc = _rate_gait(gait).arcs[0]
        s = arc.extremes()
        times += _worst_violations(s, np.abs(arc.at(s)[0]) - limits.speed)
    if np.isfinite(limits.torque).any():
        s, peaks = peak_torques(connection, gait)
        times += s[peaks > limits.torque].tolist()
    return np.unique(np.array(times) % 1.0)


def _worst_violations(s: Array, beyond: Array) -> list[float]:
    """Return for each joint the s of its largest violation among (N, m)."""
    worst = beyond.argmax(axis=0)
    return [float(s[k]) for k, joint in zip(worst, beyond.T, strict=True) if joint[k] > 0.0]


def tighten_limits(imposed: Limits, connection: Connection, gait: Gait, limits: Limits) -> Limits:
    """Tighten imposed limits by the violations of a gait.

    Args:
        imposed: Limits imposed so far.
        connection: The connection.
        gait: The gait.
        limits: Limits that the gait must satisfy.
    Returns:
        The new imposed limits.
    """
    ranges = gait.limits
    low = np.maximum(0.0, limits.shape[:, 0] - ranges[:, 0])
    high = np.maximum(0.0, ranges[:, 1] - limits.shape[:, 1])
    speed, torque = imposed.speed, imposed.torque
    if np.isfinite(speed).any():
        speed = speed - _OVERCORRECTION * np.maximum(0.0, peak_speeds(gait) - limits.speed)
    if np.isfinite(torque).any():
        peaks = peak_torques(connection, gait)[1]
        torque = torque - _OVERCORRECTION * np.maximum(0.0, peaks - limits.torque)
    shape = imposed.shape + _OVERCORRECTION * np.stack([low, -high], axis=1)
    return Limits(shape, speed, torque)


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


def peak_speeds(gait: Gait) -> Array:
    """Return the largest speed of each joint, (m,)."""
    if gait.is_smooth:
        return np.asarray(np.abs(_rate_gait(gait).limits).max(axis=1))
    return np.asarray(np.abs(gait.samples(_TIMES)[1]).max(axis=0))


def _rate_gait(gait: Gait) -> Gait:
    """Return ẋ of a Fourier gait as a path."""
    (arc,) = gait.arcs
    if not isinstance(arc, FourierArc):
        raise InputError("gait: expected one Fourier series; create it with Gait.fourier")
    k = np.arange(1, len(arc.cos) + 1)[:, None] * ((arc.end - arc.start) / gait.period)
    return Gait(
        (FourierArc(arc.time, 0.0 * arc.mean, k * arc.sin, -k * arc.cos, arc.start, arc.end),)
    )


def peak_torques(connection: Connection, gait: Gait) -> tuple[Array, Array]:
    """Compute the largest torque of each joint of a Fourier gait.

    Args:
        connection: The connection: at zero momentum, or with drag.
        gait: The gait.
    Returns:
        The positions s = t/T, (m,), and the torques, (m,) [N·m | N].
    Raises:
        InputError: The gait is not one Fourier series.
    """
    (arc,) = gait.arcs
    if not isinstance(arc, FourierArc):
        raise InputError("gait: expected one Fourier series; create it with Gait.fourier")
    turn, count = arc.end - arc.start, max(_TIMES, _PER_HARMONIC * len(arc.cos))
    coefficients = np.vstack([arc.mean[None], arc.cos, arc.sin])

    def tau(s: Array) -> Array:
        rows = fourier_rows(len(arc.cos), s, start=arc.start, turn=turn)
        return torques(connection, *(row @ coefficients for row in rows))

    s, peaks = find_extremes(tau, np.arange(count) / count)
    return s % 1.0, peaks / gait.period ** torque_order(connection)
