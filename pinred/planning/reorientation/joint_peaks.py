"""Largest speeds and torques of a loop that is repeated from rest to rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...analysis.connections.connection import Connection
from ...analysis.gaits.gait import Gait
from ...analysis.phases.path_basis import cycloid, fourier_rows
from ...common.arrays import Array, FrozenArrays
from ...common.errors import InputError
from ..optimisation.limits import Limits, find_extremes
from ..optimisation.objective import torques

_TIMES = 512  # number of samples per cycle
_SAFETY = 1.0 + 1e-6  # factor on the shortest duration, for round-off


@dataclass(frozen=True, eq=False)
class Peaks(FrozenArrays):
    """Largest speed and torque of each joint for a total duration of 1 s.

    Attributes:
        speed: Largest speed of each joint, (m,).
        torque: Largest torque of each joint, (m,).
    """

    speed: Array
    torque: Array

    def needed(self, limits: Limits) -> float:
        """Return the shortest duration within limits [s]; zero if there are no limits."""
        by_speed = np.max(self.speed / limits.speed)
        by_torque = np.sqrt(np.max(self.torque / limits.torque))
        return float(_SAFETY * max(by_speed, by_torque))

    def margins(self, limits: Limits, duration: float) -> dict[str, float]:
        """Compute the smallest distance to the limits of speeds and torques.

        Args:
            limits: The limits.
            duration: Total duration [s].
        Returns:
            Distances by kind; kinds without limits are omitted.
        """
        distances: dict[str, float] = {}
        if np.isfinite(limits.speed).any():
            distances["speeds"] = float((limits.speed - self.speed / duration).min())
        if np.isfinite(limits.torque).any():
            distances["torques"] = float((limits.torque - self.torque / duration**2).min())
        return distances


def peaks_of(connection: Connection, gait: Gait, cycles: int) -> Peaks:
    """Compute the largest speeds and torques of a Fourier gait from rest to rest.

    Args:
        connection: The mechanical connection.
        gait: The gait.
        cycles: Number of cycles.
    Returns:
        The peaks for a total duration of 1 s.
    Raises:
        InputError: The connection has drag.
    """
    if not connection.form.momentum:
        raise InputError("reorient needs a mechanical connection, without drag")
    c, chart = gait.series.coefficients(), connection.chart

    def motion(u: Array) -> tuple[Array, Array, Array]:
        angle, rate, bend = cycloid(u, cycles)
        x, x1, x2 = (rows @ c for rows in fourier_rows((len(c) - 1) // 2, angle, turn=1.0))
        return x, rate[:, None] * x1, rate[:, None] ** 2 * x2 + bend[:, None] * x1

    def speeds(u: Array) -> Array:
        w, rate, _ = motion(u)
        return rate if chart is None else chart.rates(w, rate)

    u = np.linspace(0.0, 1.0, _TIMES * cycles + 1)
    torque = find_extremes(lambda u: torques(connection, *motion(u)), u)[1]
    return Peaks(find_extremes(speeds, u)[1], torque)
