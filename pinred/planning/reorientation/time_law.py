"""The time law of a plan: n cycles by one cycloid, from rest to rest.

Of the loop, n (u − sin 2πu / 2π) is behind at u = t/D.  At zero momentum speeds go with 1/D, and
torques with 1/D².
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...analysis.connections.connection import Connection
from ...analysis.gaits.coefficients import coefficients_of
from ...analysis.gaits.gait import Gait
from ...analysis.phases.path_basis import fourier_rows
from ...common.arrays import Array, freeze
from ...common.errors import InputError
from ..optimisation.costs import torques
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
    """Return the peaks of a Fourier gait passed through so often, at equidistant times."""
    u = np.linspace(0.0, 1.0, _TIMES * cycles + 1)
    whole = 2.0 * np.pi * u
    behind = cycles * (u - np.sin(whole) / (2.0 * np.pi))
    rate, bend = cycles * (1.0 - np.cos(whole)), cycles * 2.0 * np.pi * np.sin(whole)
    c = coefficients_of(gait)
    x, x1, x2 = (rows @ c for rows in fourier_rows((len(c) - 1) // 2, behind))
    xdot = rate[:, None] * x1
    xddot = rate[:, None] ** 2 * x2 + bend[:, None] * x1
    if not connection.form.momentum:
        raise InputError("plans are of robots that inertia moves, not drag")
    tau = torques(connection, x, xdot, xddot)
    return Peaks(np.abs(xdot).max(axis=0), np.abs(tau).max(axis=0))
