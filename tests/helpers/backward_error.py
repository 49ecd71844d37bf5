"""How far accelerations are apart, in the forces that it would take, relative to those that act."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from pinred.common.arrays import Array


def largest(*parts: Any) -> float:
    """Return the largest entry of arrays, or of the arrays that are fields of a value."""
    arrays: list[Array] = []
    for part in parts:
        one = isinstance(part, np.ndarray)
        arrays += [part] if one else [getattr(part, field.name) for field in fields(part)]
    return max(float(np.abs(array).max(initial=0.0)) for array in arrays)


def backward_error(inertia: Array, a: Array, b: Array, *terms: Any) -> float:
    """Return |inertia (a − b)| over the largest of the terms that the accelerations follow from.

    A badly conditioned inertia makes accelerations of round-off in any code, forces of none.
    """
    apart = largest(inertia @ (a - b))
    return apart / largest(*terms) if apart else 0.0
