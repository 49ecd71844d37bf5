"""Second derivatives by central differences."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pinred.common.arrays import Array


def hessian(function: Callable[[Array], float], u: Array, h: float = 2e-3) -> Array:
    """Return central differences of fourth order."""
    d, H = len(u), np.empty((len(u), len(u)))
    weights = {-2: 1.0, -1: -8.0, 1: 8.0, 2: -1.0}
    for i in range(d):
        for k in range(d):
            total = 0.0
            for a, wa in weights.items():
                for b, wb in weights.items():
                    at = u + h * (a * np.eye(d)[i] + b * np.eye(d)[k])
                    total += wa * wb * function(at)
            H[i, k] = total / (12.0 * h) ** 2
    return H
