"""Finite differences, used as a reference for exact derivatives."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .arrays import Array

_WEIGHTS = ((1, 45.0 / 60.0), (2, -9.0 / 60.0), (3, 1.0 / 60.0))  # (offset, weight) of order 6


def central_differences(function: Callable[[Array], Array], x: Array, step: float) -> Array:
    """Compute the derivative of a function by central differences of order 6.

    Args:
        function: Function (m,) → (k,).
        x: Argument, (m,).
        step: Step of each entry of x.
    Returns:
        (k, m): the derivative.
    """
    derivative = np.zeros((len(x), function(x).size))
    for column, unit in zip(derivative, step * np.eye(len(x)), strict=True):
        for k, weight in _WEIGHTS:
            column += weight / step * (function(x + k * unit) - function(x - k * unit))
    return derivative.T
