"""Solver for NumPy functions with exact derivatives: SciPy's SLSQP, and its certificate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, TypeAlias

import numpy as np

from ...common.arrays import Array

# Function from the unknowns z, (n,), to the values of the objective and of k constraints,
# (1 + k,), and to their derivatives, (1 + k, n).
Evaluate: TypeAlias = Callable[[Array], tuple[Array, Array]]

_TOLERANCE = 1e-11  # SLSQP's tolerance of the scaled objective and of the sum of violations
_GAIN = 1e-9  # relative gain of a run below which no further run follows
_RUNS = 30  # largest number of runs
_SMALLER = 0.2  # size of the box around the start, relative to that of a run which failed
_SMALLEST = 1e-5  # size of the smallest box, relative to its centre
_EDGE = 0.999  # part of the radius of its box at which a run has reached the edge
_LESS = 0.5  # a run from a point that violates constraints succeeds if it leaves this part
_VIOLATION = 1e-8  # largest violation of a constraint at a minimum
_UNDEFINED = 1e10  # value of functions that are not defined, from which line searches retreat


@dataclass(frozen=True, eq=False)
class Problem:
    """An optimisation problem: minimise f(z) subject to lower ≤ (g(z), R z) ≤ upper.

    Attributes:
        size: Number of unknowns n.
        evaluate: Function of z that returns (f, g), (1 + k,), and its derivatives, (1 + k, n).
        rows: Matrix R of the linear constraints, (l, n).
        lower: Lower bounds of g and R z, (k + l,).
        upper: Upper bounds of g and R z, (k + l,).
    """

    size: int
    evaluate: Evaluate
    rows: Array
    lower: Array
    upper: Array

    @cached_property
    def _evaluated(self) -> Callable[[bytes], tuple[Array, ...]]:
        """Values and derivatives of f, g and R z at the latest points, by their bytes."""

        @lru_cache(maxsize=2)
        def at(key: bytes) -> tuple[Array, ...]:
            z = np.frombuffer(key)
            values, slopes = self.evaluate(z)
            return np.append(values, self.rows @ z), np.vstack([slopes, self.rows])

        return at

    def at(self, z: Array) -> tuple[Array, ...]:
        """Return (f, g, R z), (1 + k + l,), and its derivatives, (1 + k + l, n)."""
        return self._evaluated(np.asarray(z, dtype=float).tobytes())

    def violation(self, z: Array) -> float:
        """Return the largest violation of a constraint; NaN if one is not defined."""
        values = self.at(z)[0][1:]
        beyond = np.maximum(self.lower - values, values - self.upper)
        return float(np.max(beyond, initial=0.0))


@dataclass(frozen=True)
class Minimum:
    """Result of a search for a minimum.

    Attributes:
        z: Unknowns at the final iterate, (n,).
        status: Message of the last run of SLSQP.
        iterations: Number of iterations.
        residual: Residual of the optimality conditions at z; see `kkt_residual`.
    """

    z: Array
    status: str
    iterations: int
    residual: float


def minimum(problem: Problem, start: Array, *, most: int = 1000, radius: float = np.inf) -> Minimum:
    """Find a local minimum near an initial point.

    SLSQP also ends where a line search makes no progress.  Runs are therefore repeated, each with
    a new approximation of the Hessian, until a run gains nothing.  If a run leaves the feasible
    set, the next one starts again, in a smaller box around its start.  A failure raises no error;
    check the residual to see whether the final iterate is a minimum.

    Args:
        problem: The problem.
        start: Initial point, (n,).
        most: Maximum number of iterations.
        radius: Half width of the first box around the start.
    Returns:
        The result at the final iterate.
    """
    z, left, status = start, most, ""
    for _ in range(_RUNS):
        # Boxes are relative to the current point: below its round-off, both edges would be equal.
        size = max(float(np.abs(z).max()), 1e-300)
        run = _run(problem, z, left, radius)
        trial, status, left = np.asarray(run.x, dtype=float), str(run.message), left - int(run.nit)
        value, violation = problem.at(z)[0][0], problem.violation(z)
        gain = value - problem.at(trial)[0][0]
        if not problem.violation(trial) <= max(_VIOLATION, _LESS * violation):
            radius = _SMALLER * min(radius, size)
        elif violation > _VIOLATION:
            z = trial
        else:
            at_edge = np.abs(trial - z).max() > _EDGE * radius
            z = trial if gain > 0.0 else z
            radius /= _SMALLER
            if not at_edge and gain <= _GAIN * abs(value):
                break
        if left <= 0 or radius < _SMALLEST * size:
            break
    return Minimum(z, status, most - left, kkt_residual(problem, z))


def _run(problem: Problem, start: Array, most: int, radius: float) -> Any:
    """Run SLSQP once, in a box around its start, with the objective scaled by its gradient."""
    from scipy.optimize import minimize

    lower, upper = problem.lower, problem.upper
    fixed = lower == upper
    low, high = np.isfinite(lower) & ~fixed, np.isfinite(upper) & ~fixed
    gradient = float(np.linalg.norm(problem.at(start)[1][0]))
    scale = 1.0 / gradient if 0.0 < gradient < np.inf else 1.0

    @lru_cache(maxsize=1)
    def parts(key: bytes) -> tuple[Array, ...]:
        """Return objective, equations and inequalities with their derivatives."""
        values, slopes = problem.at(np.frombuffer(key))
        if not (np.isfinite(values).all() and np.isfinite(slopes).all()):
            values, slopes = np.full_like(values, _UNDEFINED), np.zeros_like(slopes)
        g, J = values[1:], slopes[1:]
        return (
            scale * values[0], scale * slopes[0], (g - lower)[fixed], J[fixed],
            np.concatenate([(g - lower)[low], (upper - g)[high]]), np.vstack([J[low], -J[high]]),
        )  # fmt: skip

    def pick(k: int) -> Callable[[Array], Array]:
        return lambda z: parts(z.tobytes())[k]

    kinds = (("eq", fixed.any(), 2), ("ineq", low.any() or high.any(), 4))
    constraints = [
        {"type": kind, "fun": pick(k), "jac": pick(k + 1)} for kind, used, k in kinds if used
    ]
    bounds = np.stack([start - radius, start + radius], axis=1) if radius < np.inf else None
    return minimize(
        pick(0), start, jac=pick(1), method="SLSQP", constraints=constraints, bounds=bounds,
        options={"maxiter": max(most, 1), "ftol": _TOLERANCE},
    )  # fmt: skip


def kkt_residual(problem: Problem, z: Array, *, active: float = 1e-6) -> float:
    """Compute the residual of the Karush–Kuhn–Tucker conditions, relative to f.

    The residual is min |∇f + Σ λᵢ ∇cᵢ| / |f| over the multipliers of active constraints, with λ ≥ 0
    at upper bounds and λ ≤ 0 at lower bounds.  It is computed by bounded least squares and does
    not use SLSQP's multipliers, so that it checks SLSQP independently.

    Args:
        problem: The problem.
        z: Unknowns, (n,).
        active: Relative distance to a bound below which a constraint is considered active.
    Returns:
        The residual; inf if a constraint is violated, a value is not finite, or f is zero.
    """
    from scipy.optimize import nnls

    values, slopes = problem.at(z)
    if not (np.isfinite(values).all() and np.isfinite(slopes).all() and values[0]):
        return np.inf
    if not problem.violation(z) <= _VIOLATION:
        return np.inf
    residual, constraints, gradients = slopes[0] / abs(values[0]), values[1:], slopes[1:]
    tolerance = active * np.maximum(1.0, np.abs(constraints))
    high = problem.upper - constraints < tolerance
    low = constraints - problem.lower < tolerance
    normals = np.vstack([gradients[high], -gradients[low]])
    norms = np.linalg.norm(normals, axis=1)
    if (norms > 0.0).any():
        normals = normals[norms > 0.0] / norms[norms > 0.0, None]
        residual = residual + nnls(normals.T, -residual)[0] @ normals
    size = float(np.linalg.norm(residual))
    return size if np.isfinite(size) else np.inf
