"""Solver for NumPy functions with exact derivatives: the IPOPT in CasADi's wheel."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from ...common.arrays import Array
from ...common.casadi_callback import ArrayCallback, dense
from ...common.interrupts import held_interrupt

# Options that keep the first iterate near bounds that are active at the start.
_PUSHES = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac")
_WARM = {f"ipopt.{name}": 1e-8 for name in _PUSHES} | {
    "ipopt.mu_strategy": "monotone",
    "ipopt.mu_init": 1e-5,
}

# Function from the unknowns z, (n,), to the values of the objective and of k constraints,
# (1 + k,), and to their derivatives, (1 + k, n).
Evaluate: TypeAlias = Callable[[Array], tuple[Array, Array]]


_STEP = 1e-6  # step of the differences of gradients


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

    @property
    def constraints(self) -> int:
        """Number k of nonlinear constraints g."""
        return len(self.lower) - len(self.rows)


@dataclass(frozen=True)
class Minimum:
    """Result of an IPOPT solve.

    Attributes:
        z: Unknowns at the final iterate, (n,).
        status: Return status of IPOPT.
        iterations: Number of iterations.
        residual: Residual of the optimality conditions at z; see `kkt_residual`.
    """

    z: Array
    status: str
    iterations: int
    residual: float


def minimum(
    problem: Problem,
    start: Array,
    *,
    tolerance: float = 1e-8,
    most: int = 500,
    newton: bool = False,
) -> Minimum:
    """Find a local minimum near an initial point.

    A failure raises no error; check the residual to see
    whether the final iterate is a minimum.

    Args:
        problem: The problem.
        start: Initial point, (n,).
        tolerance: IPOPT's tolerance.
        most: Maximum number of iterations.
        newton: Whether to compute the Hessian by differences of gradients; otherwise it is
            approximated by L-BFGS.
    Returns:
        The result at the final iterate.
    """
    with held_interrupt() as pressed:
        function = _Function(problem, pressed)
        z = ca.MX.sym("z", problem.size)
        values = function(z)
        constraints = [values[1:]] if problem.constraints else []
        if len(problem.rows):
            constraints.append(ca.densify(ca.mtimes(ca.sparsify(ca.DM(problem.rows)), z)))
        nlp: Any = {"x": z, "f": values[0], "g": ca.vertcat(ca.MX(0, 1), *constraints)}
        gradient = float(np.linalg.norm(problem.evaluate(start)[1][0]))
        options: Any = {
            "ipopt.obj_scaling_factor": 1.0 / gradient if 0.0 < gradient < np.inf else 1.0,
            "ipopt.hessian_approximation": "limited-memory",
            "ipopt.limited_memory_max_history": 30,
            "ipopt.tol": tolerance,
            "ipopt.acceptable_tol": 1e2 * tolerance,
            "ipopt.acceptable_obj_change_tol": 1e-11,
            "ipopt.acceptable_iter": 3,
            "ipopt.max_iter": most,
            "ipopt.bound_relax_factor": 0.0,
            "ipopt.mu_strategy": "adaptive",
            "ipopt.print_level": 0,
            "ipopt.sb": "yes",
            "print_time": False,
            "show_eval_warnings": False,
        }
        if newton:
            hessian = function.hessian()
            options |= {"ipopt.hessian_approximation": "exact", "hess_lag": hessian} | _WARM
        solver = ca.nlpsol("gait", "ipopt", nlp, options)
        solution = solver(x0=start, lbg=problem.lower, ubg=problem.upper)
        stats = solver.stats()
    best = np.array(solution["x"]).ravel()
    return Minimum(
        best, str(stats["return_status"]), int(stats["iter_count"]), kkt_residual(problem, best)
    )


def kkt_residual(problem: Problem, z: Array, *, active: float = 1e-6) -> float:
    """Compute the residual of the Karush–Kuhn–Tucker conditions, relative to f.

    The residual is min |∇f + Σ λᵢ ∇cᵢ| / |f| over the multipliers of active constraints, with λ ≥ 0
    at upper bounds and λ ≤ 0 at lower bounds.  It is computed by bounded least squares and does
    not use IPOPT's multipliers, so that it checks IPOPT independently.

    Args:
        problem: The problem.
        z: Unknowns, (n,).
        active: Relative distance to a bound below which a constraint is considered active.
    Returns:
        The residual; inf if a value is not finite or f is zero.
    """
    from scipy.optimize import lsq_linear

    values, slopes = problem.evaluate(z)
    if not (np.isfinite(values).all() and np.isfinite(slopes).all() and values[0]):
        return np.inf
    residual = slopes[0] / abs(values[0])
    constraints = np.concatenate([values[1:], problem.rows @ z])
    gradients = np.vstack([slopes[1:], problem.rows])
    tolerance = active * np.maximum(1.0, np.abs(constraints))
    high = problem.upper - constraints < tolerance
    low = constraints - problem.lower < tolerance
    norms = np.linalg.norm(gradients, axis=1)
    use = (high | low) & (norms > 0.0)
    if use.any():
        bounds = np.where(low[use], -np.inf, 0.0), np.where(high[use], np.inf, 0.0)
        normals = (gradients[use] / norms[use, None]).T
        with np.errstate(invalid="ignore"):  # SciPy tries steps of infinite length
            residual = lsq_linear(normals, -residual, bounds, tol=1e-14).fun
    size = float(np.linalg.norm(residual))
    return size if np.isfinite(size) else np.inf


class _Function(ArrayCallback):
    """Objective and constraints as a CasADi callback."""

    def __init__(self, problem: Problem, stopped: Callable[[], bool]) -> None:
        self._problem, self._stopped = problem, stopped
        self._last: tuple[Array, tuple[Array, Array]] | None = None
        self._size = 1 + problem.constraints
        outputs = [dense("values", self._size)]
        super().__init__("gait", [dense("z", problem.size)], outputs, lambda z: [self.at(z[0])[0]])

    def at(self, column: Array) -> tuple[Array, Array]:
        """Return values and derivatives; after Ctrl-C return NaN, which stops IPOPT."""
        z = column.ravel()
        if self._last is None or not np.array_equal(self._last[0], z):
            values, slopes = self._problem.evaluate(z)
            self._last = z.copy(), (values, slopes)
        values, slopes = self._last[1]
        return (np.full_like(values, np.nan), slopes) if self._stopped() else (values, slopes)

    def has_jacobian(self) -> bool:
        return True

    def get_jacobian(self, name: str, inames: Any, onames: Any, _options: Any) -> Any:
        inputs = [dense(inames[0], self._problem.size), dense(inames[1], self._size)]
        outputs = [dense(onames[0], self._size, self._problem.size)]
        # Store a reference, because CasADi stores none.
        self._jacobian = ArrayCallback(name, inputs, outputs, lambda z: [self.at(z[0])[1]])
        return self._jacobian

    def hessian(self) -> ArrayCallback:
        """Return the upper triangle of the Hessian of the Lagrangian as a CasADi Function."""
        n = self._problem.size
        names, sizes = ("x", "p", "lam_f", "lam_g"), (n, 0, 1, len(self._problem.lower))
        inputs = [dense(name, size) for name, size in zip(names, sizes, strict=True)]
        outputs = [("hessian", ca.Sparsity.upper(n))]
        return ArrayCallback("hessian", inputs, outputs, self._differences)

    def _differences(self, inputs: Sequence[Array]) -> list[Any]:
        """Return the Hessian for inputs of IPOPT, by differences of gradients."""
        z, _, lam_f, lam_g = (array.ravel() for array in inputs)
        weights = np.concatenate([lam_f, lam_g[: self._problem.constraints]])
        gradient = weights @ self.at(z)[1]
        moved = [weights @ self.at(z + step)[1] for step in _STEP * np.eye(len(z))]
        differences = (np.array(moved) - gradient) / _STEP
        return [ca.triu(ca.DM(0.5 * (differences + differences.T)))]
