"""The time law of a plan: n cycles by one cycloid, from rest to rest.

Of the loop, n (u − sin 2πu / 2π) is behind at u = t/D (`cycloid`).  At zero momentum speeds go with
1/D, and torques with 1/D².
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...analysis.connections.connection import Connection
from ...analysis.gaits.coefficients import coefficients_of
from ...analysis.gaits.gait import Gait
from ...analysis.phases.path_basis import cycloid, fourier_rows
from ...common.arrays import Array, freeze
from ...common.errors import InputError
from ..optimisation.costs import torques
from ..optimisation.extremes import greatest
from ..optimisation.limits import Limits

_TIMES = 512  # a cycle
_ROOM = 1.0 + 1e-6


@dataclass(frozen=True, eq=False)
class Peaks:
    """Greatest speed and torque of each joint, (m,), if all takes a second."""

    speed: Array
    torque: Array

    def __post_init__(self) -> None:
        freeze(self)

    def needed(self, limits: Limits) -> float:
        """Return the least duration within limits [s]; zero without any."""
        by_speed = np.max(self.speed / limits.speed)
        by_torque = np.sqrt(np.max(self.torque / limits.torque))
        return float(_ROOM * max(by_speed, by_torque))

    def margins(self, limits: Limits, duration: float) -> dict[str, float]:
        """Return the least distance to limits of speeds and torques, where there are any."""
        out: dict[str, float] = {}
        if np.isfinite(limits.speed).any():
            out["speeds"] = float((limits.speed - self.speed / duration).min())
        if np.isfinite(limits.torque).any():
            out["torques"] = float((limits.torque - self.torque / duration**2).min())
        return out


def peaks_of(connection: Connection, gait: Gait, cycles: int) -> Peaks:
    """Return the peaks of a Fourier gait passed through so often, wherever they lie."""
    if not connection.form.momentum:
        raise InputError("plans are of robots that inertia moves, not drag")
    c = coefficients_of(gait)

    def motion(u: Array) -> tuple[Array, Array, Array]:
        angle, rate, bend = cycloid(u, cycles)
        x, x1, x2 = (rows @ c for rows in fourier_rows((len(c) - 1) // 2, angle, turn=1.0))
        return x, rate[:, None] * x1, rate[:, None] ** 2 * x2 + bend[:, None] * x1

    u = np.linspace(0.0, 1.0, _TIMES * cycles + 1)
    speed = greatest(lambda u: motion(u)[1], u)[1]
    torque = greatest(lambda u: torques(connection, *motion(u)), u)[1]
    return Peaks(speed, torque)
