"""Levenberg–Marquardt iteration for equations whose solutions are not isolated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...common.arrays import Array
from ...common.errors import IntegrationError

_DAMPING = 1e-4  # initial damping, relative to the largest singular value
_LEAST, _LARGEST = 1e-9, 1e3  # range of the damping


@dataclass(frozen=True, eq=False)
class Root:
    """The end of an iteration.

    Attributes:
        z: Unknowns, (n,).
        residual: Norm of the residual.
        iterations: Number of iterations.
    """

    z: Array
    residual: float
    iterations: int


def levenberg_marquardt(
    residuals: Callable[[Array], Array],
    jacobian: Callable[[Array], Array],
    start: Array,
    *,
    tolerance: float,
    most: int = 30,
) -> Root:
    """Solve R(z) = 0 near an initial point.

    Steps have least norm, so that directions along which R is constant remain at rest.

    Args:
        residuals: The function R: (n,) → (k,), which may raise IntegrationError.
        jacobian: Its derivatives, (n,) → (k, n).
        start: Initial point, (n,).
        tolerance: Norm of the residual of a solution, which is refined while steps succeed at once.
        most: Maximum number of iterations.
    Returns:
        The last point; check its residual.
    """
    z, damping, value = start, _DAMPING, residuals(start)
    for done in range(most):
        size = float(np.linalg.norm(value))
        U, s, V = np.linalg.svd(jacobian(z), full_matrices=False)
        along = U.T @ value
        trial, trial_value = z, value
        while damping <= _LARGEST:
            trial = z - V.T @ (s / (s**2 + (damping * s[0]) ** 2) * along)
            trial_value = _value(residuals, trial)
            if float(np.linalg.norm(trial_value)) < size or size <= tolerance:
                break
            damping *= 10.0
        if not float(np.linalg.norm(trial_value)) < size:
            return Root(z, size, done)
        z, value, damping = trial, trial_value, max(0.1 * damping, _LEAST)
    return Root(z, float(np.linalg.norm(value)), most)


def _value(residuals: Callable[[Array], Array], z: Array) -> Array:
    """Return the residual, or infinity where it is not defined."""
    try:
        return residuals(z)
    except IntegrationError:
        return np.array([np.inf])
