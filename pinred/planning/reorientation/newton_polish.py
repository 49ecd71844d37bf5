"""Newton's polish: least changes of a loop, until it turns the base to the last digit."""

from __future__ import annotations

import numpy as np

from ...analysis.connections.connection import Connection
from ...analysis.phases.path_basis import path_lift
from ...common.arrays import Array
from ..optimisation.aims import Reach
from ..optimisation.transcription import Path

_STEPS = 4
_DONE = 1e-14  # rad


def polished(connection: Connection, aim: Reach, path: Path, y: Array) -> Array:
    """Return unknowns near y that reach the aim, by steps of least norm, Δy = −J⁺ r."""
    for _ in range(_STEPS):
        lift = path_lift(connection, path.basis, path.coefficients(y))
        missed, by_twist = aim.missed(lift.pose)
        if float(np.linalg.norm(missed)) <= _DONE:
            break
        slopes = np.tensordot(by_twist, lift.twist, 1).reshape(len(missed), -1) @ path.matrix
        y = y - np.linalg.lstsq(slopes, missed, rcond=1e-12)[0]
    return y
