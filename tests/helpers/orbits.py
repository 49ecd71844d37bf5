"""The Kepler orbit in closed form."""

from __future__ import annotations

import numpy as np

from pinred.common.arrays import Array


def kepler_orbit(e: float, t: Array) -> Array:
    """Return the states (T, 4) of an orbit of period 2π and eccentricity e from its pericentre."""
    E = t.copy()
    for _ in range(60):
        E -= (E - e * np.sin(E) - t) / (1.0 - e * np.cos(E))
    r, b = 1.0 - e * np.cos(E), np.sqrt(1.0 - e * e)
    return np.stack([np.cos(E) - e, b * np.sin(E), -np.sin(E) / r, b * np.cos(E) / r], axis=1)
