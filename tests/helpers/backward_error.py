"""Errors of accelerations and forces, relative to the terms that they are sums of."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from pinred.common.arrays import Array


def largest(*terms: Any) -> float:
    """Return the largest absolute entry.

    Args:
        terms: Numbers, arrays, or dataclasses whose fields are arrays.
    """
    arrays: list[Array] = []
    for term in terms:
        if isinstance(term, float | np.ndarray):
            arrays.append(np.asarray(term))
        else:
            arrays += [getattr(term, field.name) for field in fields(term)]
    return max(float(np.abs(array).max(initial=0.0)) for array in arrays)


def kinetic_size(mass_matrix: Array, v: Array) -> float:
    """Return |v|ᵀ |H| |v|, the size of the Coriolis and centrifugal terms before cancellation.

    Such a term is a sum over links. Its round-off scales with this number, also if the sum is
    nearly or exactly zero.

    Args:
        mass_matrix: H, (n, n), in the section in which the equations are evaluated.
        v: Velocity, (n,), in the same section.
    """
    return float(np.abs(v) @ np.abs(mass_matrix) @ np.abs(v))


def backward_error(inertia: Array, a: Array, b: Array, *terms: Any) -> float:
    """Return |inertia (a − b)| relative to the largest of the given terms.

    An ill-conditioned inertia amplifies round-off in accelerations, but not in forces.

    Args:
        inertia: Matrix that turns accelerations into forces.
        a: Accelerations.
        b: Reference accelerations.
        terms: Terms that the accelerations are computed from (see `largest`).
    """
    difference = largest(inertia @ (a - b))
    return difference / largest(*terms) if difference else 0.0
