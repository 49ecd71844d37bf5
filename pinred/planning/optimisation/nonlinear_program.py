"""Solver for NumPy functions with exact derivatives: SciPy's SLSQP, and its certificate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

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
_ACTIVE = 1e-6  # relative distance to a bound below which a constraint is active
_LONGEST = 40  # smallest limit of the iterations of a run
_MISSES = 3  # number of runs without a feasible point after which the search ends
_SHARP_STEPS = 10  # largest number of iterations of a run with the Hessian
_STEP_SIZE = 0.1  # half width of its box, in the units of the Hessian
_SHARP = 1e-7  # KKT residual below which no run with the Hessian follows
_SHARPENINGS = 4  # largest number of runs with the Hessian
_NEAR = 1e-4  # relative distance to a bound below which a constraint is part of the Lagrangian
_STEP = 1e-6  # step of differences of gradients, relative to the largest unknown
_FLAT = 1e-6  # smallest bend of an axis of the Hessian, relative to the largest one
_FINE = 1e-14  # SLSQP's tolerance in the units of the Hessian
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

    @property
    def equations(self) -> NDArray[np.bool_]:
        """Whether both bounds of each constraint are equal, (k + l,)."""
        return np.asarray(self.lower == self.upper)

    def beyond(self, z: Array) -> Array:
        """Return the violations of the constraints, (k + l,); NaN where one is not defined."""
        values = self.at(z)[0][1:]
        return np.maximum(np.maximum(self.lower - values, values - self.upper), 0.0)

    def violation(self, z: Array) -> float:
        """Return the largest violation of a constraint; NaN if one is not defined."""
        return float(np.max(self.beyond(z), initial=0.0))


@dataclass(frozen=True)
class Minimum:
    """Result of a search for a minimum.

    Attributes:
        z: Unknowns at the final iterate, (n,).
        value: Objective at z.
        status: Message of the last run of SLSQP.
        iterations: Number of iterations.
        residual: Residual of the optimality conditions at z; see `kkt_residual`.
    """

    z: Array
    value: float
    status: str
    iterations: int
    residual: float


def minimum(
    problem: Problem,
    start: Array,
    *,
    most: int = 1000,
    radius: float = np.inf,
    once: bool = False,
) -> Minimum:
    """Find a local minimum near an initial point.

    SLSQP also ends where a line search makes no progress.  Runs are therefore repeated, each with
    a new approximation of the Hessian, until a run gains nothing.  After a run that used all its
    iterations, and with equations, the next one begins with the Hessian.  If a run leaves the
    feasible set without a gain, the next one starts again, in a smaller box around its start.
    A failure raises no error; check the residual to see whether the final iterate is a minimum.

    Args:
        problem: The problem.
        start: Initial point, (n,).
        most: Maximum number of iterations.
        radius: Half width of the first box around the start.
        once: Whether the search ends after a run that SLSQP calls successful.
    Returns:
        The result at the final iterate.
    """
    z, remaining, status, misses, units = start, most, "", 0, None
    longest = max(_LONGEST, 2 * problem.size)
    for _ in range(_RUNS):
        # Boxes are relative to the current point: below its round-off, both edges would be equal.
        size = max(float(np.abs(z).max()), 1e-300)
        box = radius if units is None else radius / np.linalg.norm(units, axis=0)
        run = _run(problem, z, min(remaining, longest), radius=box, units=units)
        trial, status, remaining = run.x, str(run.message), remaining - int(run.nit)
        value, violation = problem.at(z)[0][0], problem.violation(z)
        gain, left_over = value - problem.at(trial)[0][0], problem.violation(trial)
        feasible, at_edge = violation <= _VIOLATION, np.abs(trial - z).max() > _EDGE * radius
        restored = left_over <= max(_VIOLATION, _LESS * violation)
        misses += not (feasible or restored)
        if not (restored or _gains(problem, z, trial)):
            radius = _SMALLER * min(radius, size)
        else:
            z = trial if gain > 0.0 or not feasible else z
            done = once and run.success and left_over <= _VIOLATION
            done |= feasible and gain <= _GAIN * abs(value)
            if done and not at_edge and run.nit < longest:
                break
            radius /= _SMALLER if feasible else 1.0
        if remaining <= 0 or radius < _SMALLEST * size or misses >= _MISSES:
            break
        slow = problem.equations.any() and run.nit >= longest
        defined = 0.0 < abs(problem.at(z)[0][0]) < np.inf
        units = _newton_units(problem, z) if slow and defined else None
    value = float(problem.at(z)[0][0])
    return Minimum(z, value, status, most - remaining, kkt_residual(problem, z))


def _gains(problem: Problem, z: Array, trial: Array) -> bool:
    """Return whether a point lowers the objective by more than its violations are worth.

    Runs along curved equations often end at points that are better but slightly beyond them.
    """
    (before, _), (after, slopes) = problem.at(z), problem.at(trial)
    defined = np.isfinite(after).all() and np.isfinite(slopes).all() and after[0] != 0.0
    if not (problem.equations.any() and defined):
        return False
    price = abs(after[0]) * np.abs(_multipliers(problem, trial, _NEAR)[1])
    gain = before[0] - after[0] + price @ (problem.beyond(z) - problem.beyond(trial))
    return bool(gain > _GAIN * abs(before[0]))


def sharpened(problem: Problem, best: Minimum) -> Minimum:
    """Improve a minimum by Newton's method: runs of SLSQP that begin with the Hessian.

    Args:
        problem: The problem.
        best: A minimum of the problem, by `minimum`.
    Returns:
        The improved minimum, or the given one if its residual is not reduced.
    """
    for _ in range(_SHARPENINGS):
        if not _SHARP < best.residual < np.inf:
            break
        units = _newton_units(problem, best.z)
        run = _run(problem, best.z, _SHARP_STEPS, radius=_STEP_SIZE, units=units, tolerance=_FINE)
        residual = kkt_residual(problem, run.x)
        if not residual < best.residual:
            break
        best = replace(
            best, z=run.x, value=float(problem.at(run.x)[0][0]), residual=residual,
            iterations=best.iterations + int(run.nit),
        )  # fmt: skip
    return best


def _newton_units(problem: Problem, z: Array) -> Array:
    """Return units U, (n, n), of steps z = z₀ + U y, in which the Hessian of the Lagrangian is 1.

    This holds for steps along active constraints.  Steps across them have a single unit.
    """
    multipliers = _multipliers(problem, z, _NEAR)[1]
    weights = np.append(1.0 / abs(problem.at(z)[0][0]), multipliers)
    step = _STEP * max(float(np.abs(z).max()), 1e-300)
    gradients = [weights @ problem.at(point)[1] for point in z + step * np.eye(len(z))]
    H = (np.array(gradients) - weights @ problem.at(z)[1]) / step
    normals = problem.at(z)[1][1:][multipliers != 0.0]
    axes, sizes, _ = np.linalg.svd(normals.T)
    rank = int((sizes > _STEP * sizes.max(initial=0.0)).sum())
    across, tangents = np.split(axes, [rank], axis=1)
    bends, mixture = np.linalg.eigh(tangents.T @ (H + H.T) @ tangents)
    size = float(np.abs(bends).max(initial=0.0)) or 1.0
    bends = np.append(np.full(rank, size), np.maximum(np.abs(bends), _FLAT * size))
    return np.asarray(np.hstack([across, tangents @ mixture]) / np.sqrt(0.5 * bends))


def _run(
    problem: Problem,
    start: Array,
    most: int,
    *,
    radius: Array | float = np.inf,
    units: Array | None = None,
    tolerance: float = _TOLERANCE,
) -> Any:
    """Run SLSQP once, with the objective scaled by its gradient, or by its value with units.

    The products of equations with their multipliers, and half of their squares, are added to the
    objective.  They are zero where the equations hold.  Without them, line searches accept only
    short steps along curved equations.

    Args:
        problem: The problem.
        start: Initial point, (n,).
        most: Maximum number of iterations.
        radius: Half width of a box around the start, in the unknowns of the run, or half widths,
            (n,).
        units: Units U of the unknowns y with z = start + U y, or None for the unknowns z.
        tolerance: SLSQP's tolerance.
    Returns:
        SciPy's result.
    """
    from scipy.optimize import minimize

    lower, upper, fixed = problem.lower, problem.upper, problem.equations
    low, high = np.isfinite(lower) & ~fixed, np.isfinite(upper) & ~fixed
    values, slopes = problem.at(start)
    size, gradient = abs(values[0]), float(np.linalg.norm(slopes[0]))
    scale = 1.0 / gradient if 0.0 < gradient < np.inf else 1.0
    weights = np.zeros(int(fixed.sum()))
    if fixed.any() and size > 0.0:
        weights = _multipliers(problem, start, _NEAR)[1][fixed]
    if units is None:
        first, origin, units = start, np.zeros(len(start)), np.eye(len(start))
    else:
        first, origin, scale = np.zeros(len(start)), start, 1.0 / size

    @lru_cache(maxsize=1)
    def parts(key: bytes) -> tuple[Array, ...]:
        """Return objective, equations and inequalities with their derivatives."""
        values, slopes = problem.at(origin + units @ np.frombuffer(key))
        if not (np.isfinite(values).all() and np.isfinite(slopes).all()):
            values, slopes = np.full_like(values, _UNDEFINED), np.zeros_like(slopes)
        slopes = slopes @ units
        g, J = values[1:], slopes[1:]
        error, by_y = (g - lower)[fixed], J[fixed]
        terms = weights * error
        return (
            scale * (values[0] + size * (terms + 0.5 * terms**2).sum()),
            scale * (slopes[0] + size * ((1.0 + terms) * weights) @ by_y), error, by_y,
            np.concatenate([(g - lower)[low], (upper - g)[high]]), np.vstack([J[low], -J[high]]),
        )  # fmt: skip

    def pick(k: int) -> Callable[[Array], Array]:
        return lambda y: parts(y.tobytes())[k]

    kinds = (("eq", fixed.any(), 2), ("ineq", low.any() or high.any(), 4))
    constraints = [
        {"type": kind, "fun": pick(k), "jac": pick(k + 1)} for kind, used, k in kinds if used
    ]
    boxed = np.all(radius < np.inf)
    bounds = np.stack([first - radius, first + radius], axis=1) if boxed else None
    run = minimize(
        pick(0), first, jac=pick(1), method="SLSQP", constraints=constraints, bounds=bounds,
        options={"maxiter": max(most, 1), "ftol": tolerance},
    )  # fmt: skip
    run.x = origin + units @ np.asarray(run.x, dtype=float)
    return run


def kkt_residual(problem: Problem, z: Array) -> float:
    """Compute the residual of the Karush–Kuhn–Tucker conditions, relative to f.

    The residual is min |∇f + Σ λᵢ ∇cᵢ| / |f| over the multipliers of active constraints, with λ ≥ 0
    at upper bounds and λ ≤ 0 at lower bounds.  It is computed by bounded least squares and does
    not use SLSQP's multipliers, so that it checks SLSQP independently.

    Args:
        problem: The problem.
        z: Unknowns, (n,).
    Returns:
        The residual; inf if a constraint is violated, a value is not finite, or f is zero.
    """
    values, slopes = problem.at(z)
    if not (np.isfinite(values).all() and np.isfinite(slopes).all() and values[0]):
        return np.inf
    if not problem.violation(z) <= _VIOLATION:
        return np.inf
    size = float(np.linalg.norm(_multipliers(problem, z, _ACTIVE)[0]))
    return size if np.isfinite(size) else np.inf


def _multipliers(problem: Problem, z: Array, active: float) -> tuple[Array, Array]:
    """Return (∇f + Σ λᵢ ∇cᵢ) / |f|, (n,), of least norm, and the multipliers λ / |f|, (k + l,)."""
    from scipy.optimize import nnls

    values, slopes = problem.at(z)
    residual, constraints, gradients = slopes[0] / abs(values[0]), values[1:], slopes[1:]
    tolerance = active * np.maximum(1.0, np.abs(constraints))
    high = np.flatnonzero(problem.upper - constraints < tolerance)
    low = np.flatnonzero(constraints - problem.lower < tolerance)
    rows, signs = np.append(high, low), np.append(np.ones(len(high)), -np.ones(len(low)))
    normals = signs[:, None] * gradients[rows]
    norms = np.linalg.norm(normals, axis=1)
    rows, signs, normals, norms = (array[norms > 0.0] for array in (rows, signs, normals, norms))
    multipliers = np.zeros(len(constraints))
    if len(rows):
        solution = nnls((normals / norms[:, None]).T, -residual)[0] / norms
        residual = residual + solution @ normals
        np.add.at(multipliers, rows, signs * solution)
    return residual, multipliers
