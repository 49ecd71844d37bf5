"""Margins: how far a gait stays from its limits, at its true extremes."""

from __future__ import annotations

import numpy as np

from ...analysis.connections.connection import Connection
from ...analysis.gaits.arcs import FourierArc
from ...analysis.gaits.gait import Gait
from ...analysis.phases.path_basis import fourier_rows
from ...common.arrays import Array
from ...common.errors import InputError
from .costs import torque_order, torques
from .extremes import greatest
from .limits import Limits

_TIMES = 1024  # at which torques are looked at, and between which, at least
_PER_HARMONIC = 64  # of these times
_MORE = 1.1  # times what is overshot


def worst_times(connection: Connection, gait: Gait, limits: Limits) -> Array:
    """Return the s = t/T at which a Fourier gait goes furthest beyond limits; none if it does not.

    Those of every joint, and of its speed and torque.
    """
    (arc,) = gait.arcs
    s = arc.extremes()
    x = arc.at(s)[0]
    found = _beyond(s, np.maximum(limits.shape[:, 0] - x, x - limits.shape[:, 1]))
    if np.isfinite(limits.speed).any():
        arc = _rate(gait).arcs[0]
        s = arc.extremes()
        found += _beyond(s, np.abs(arc.at(s)[0]) - limits.speed)
    if np.isfinite(limits.torque).any():
        at, most = strongest(connection, gait)
        found += at[most > limits.torque].tolist()
    return np.unique(np.array(found) % 1.0)


def _beyond(s: Array, beyond: Array) -> list[float]:
    """Return for each joint the s (N,) at which it is furthest beyond its limit, (N, m)."""
    worst = beyond.argmax(axis=0)
    return [float(s[k]) for k, joint in zip(worst, beyond.T, strict=True) if joint[k] > 0.0]


def tightened(imposed: Limits, connection: Connection, gait: Gait, limits: Limits) -> Limits:
    """Return the imposed limits, less what a gait goes beyond those that hold."""
    ranges = gait.limits
    low = np.maximum(0.0, limits.shape[:, 0] - ranges[:, 0])
    high = np.maximum(0.0, ranges[:, 1] - limits.shape[:, 1])
    speed, torque = imposed.speed, imposed.torque
    if np.isfinite(speed).any():
        speed = speed - _MORE * np.maximum(0.0, speeds(gait) - limits.speed)
    if np.isfinite(torque).any():
        most = strongest(connection, gait)[1]
        torque = torque - _MORE * np.maximum(0.0, most - limits.torque)
    shape = imposed.shape + _MORE * np.stack([low, -high], axis=1)
    return Limits(shape, speed, torque)


def margins(connection: Connection, gait: Gait, limits: Limits) -> dict[str, float]:
    """Return the least distance to the limits of a kind, negative beyond: shape, speed, torque.

    In the units of the joints; kinds without limits are left out.
    """
    ranges = gait.limits
    out = {
        "limits": float(
            np.minimum(ranges[:, 0] - limits.shape[:, 0], limits.shape[:, 1] - ranges[:, 1]).min()
        )
    }
    if np.isfinite(limits.speed).any():
        out["speeds"] = float((limits.speed - speeds(gait)).min())
    if np.isfinite(limits.torque).any():
        out["torques"] = float((limits.torque - strongest(connection, gait)[1]).min())
    return out


def speeds(gait: Gait) -> Array:
    """Return the greatest speed of each joint, (m,)."""
    if gait.is_smooth:
        return np.asarray(np.abs(_rate(gait).limits).max(axis=1))
    return np.asarray(np.abs(gait.samples(_TIMES)[1]).max(axis=0))


def _rate(gait: Gait) -> Gait:
    """Return ẋ of a Fourier gait, as a path of its own."""
    (arc,) = gait.arcs
    if not isinstance(arc, FourierArc):
        raise InputError("only a gait that is one Fourier series has a rate that is one")
    k = np.arange(1, len(arc.cos) + 1)[:, None] * ((arc.end - arc.start) / gait.period)
    return Gait(
        (FourierArc(arc.time, 0.0 * arc.mean, k * arc.sin, -k * arc.cos, arc.start, arc.end),)
    )


def strongest(connection: Connection, gait: Gait) -> tuple[Array, Array]:
    """Return at which s = t/T each joint of a Fourier gait needs its greatest torque, and that.

    (m,) and (m,) [N m | N], at zero momentum or against drag.
    """
    (arc,) = gait.arcs
    if not isinstance(arc, FourierArc):
        raise InputError("torques are of a gait that is one Fourier series")
    turn, count = arc.end - arc.start, max(_TIMES, _PER_HARMONIC * len(arc.cos))
    coefficients = np.vstack([arc.mean[None], arc.cos, arc.sin])

    def tau(s: Array) -> Array:
        rows = fourier_rows(len(arc.cos), s, start=arc.start, turn=turn)
        return torques(connection, *(row @ coefficients for row in rows))

    at, most = greatest(tau, np.arange(count) / count)
    return at % 1.0, most / gait.period ** torque_order(connection)
