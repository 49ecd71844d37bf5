"""An explicit Runge–Kutta method as numbers: its stages, its error, its dense output."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...common.arrays import Array, freeze
from ...common.errors import InputError

_ROUND_OFF = 1e-12  # of sums of weights


@dataclass(frozen=True, eq=False)
class Tableau:
    """An explicit method of s stages, whose rate at the end of a step begins the next one.

    A: (s + 1 + e, s + 1 + e), below its diagonal the weights of the rates from which the states
    come: s stages, the first of them the begin of the step; its end; e more for dense output.
    errors: (1, s + 1), weights of what the step is apart from one of a lower order; or (2, s + 1),
    two such that make one estimate as Hairer's DOP853 does.
    dense: (d, s + 1 + e), for the polynomial that goes on where Hermite's cubic ends, with
    y the rest of x to one: y₀ + x (F₀ + y (F₁ + x (F₂ + y (F₃ + x (F₄ + …))))).  F₃ and what
    follows are sums of rates by these weights; without any it is the cubic.
    Raises InputError for shapes and sums that are none of a method.
    """

    A: Array
    errors: Array
    dense: Array

    def __post_init__(self) -> None:
        freeze(self)
        A, errors, dense, size = self.A, self.errors, self.dense, len(self.A)
        if A.ndim != 2 or A.shape != (size, size) or A[np.triu_indices(size)].any():
            raise InputError(f"A must be square and zero from its diagonal on, got {A.shape}")
        if errors.ndim != 2 or len(errors) not in (1, 2) or not 2 <= errors.shape[1] <= size:
            raise InputError(f"errors must have shape (1 or 2, s + 1), got {errors.shape}")
        if dense.ndim != 2 or dense.shape[1] != size:
            raise InputError(f"dense must have shape (d, {size}), got {dense.shape}")
        for name, rows, total in (
            ("the end", A[self.stages], 1.0), ("errors", errors, 0.0), ("dense", dense, 0.0),
        ):  # fmt: skip
            sums = np.atleast_2d(rows).sum(axis=1)
            if not np.allclose(sums, total, rtol=0.0, atol=_ROUND_OFF * max(1.0, abs(rows).sum())):
                raise InputError(f"weights of {name} must add up to {total:g}, got {sums}")
        if not np.atleast_2d(errors).any(axis=1).all():
            raise InputError("errors must have weights that are not zero")

    @property
    def stages(self) -> int:
        """Number of stages without the end."""
        return int(self.errors.shape[1]) - 1
