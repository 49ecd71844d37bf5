"""IPOPT, as CasADi's wheel brings it, on functions of NumPy with exact derivatives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from ...common.arrays import Array
from ...common.interrupts import held_interrupt

# z (n,) → the objective and the constraints (1 + k,), and their derivatives (1 + k, n).
Evaluate: TypeAlias = Callable[[Array], tuple[Array, Array]]


@dataclass(frozen=True, eq=False)
class Problem:
    """Least f(z) with lower ≤ (g(z), R z) ≤ upper.

    evaluate: f and g, (1 + k,), with derivatives.  rows: R (l, n).  lower, upper: (k + l,).
    """

    size: int
    evaluate: Evaluate
    rows: Array
    lower: Array
    upper: Array

    @property
    def constraints(self) -> int:
        """Number of entries of g."""
        return len(self.lower) - len(self.rows)


@dataclass(frozen=True)
class Minimum:
    """Where IPOPT stopped.  status: in its words.  residual: see `kkt_residual`."""

    z: Array
    status: str
    iterations: int
    residual: float


def minimum(problem: Problem, start: Array, *, tolerance: float = 1e-8, most: int = 500) -> Minimum:
    """Return a local minimum near a start (n,).

    Its Hessian is built by L-BFGS.  A failure is no error: the residual tells what was found.
    """
    with held_interrupt() as pressed:
        function = _Function(problem, pressed)
        z = ca.MX.sym("z", problem.size)
        out = function(z)
        constraints = [out[1:]] if problem.constraints else []
        if len(problem.rows):
            constraints.append(ca.densify(ca.mtimes(ca.sparsify(ca.DM(problem.rows)), z)))
        parts: Any = {"x": z, "f": out[0], "g": ca.vertcat(ca.MX(0, 1), *constraints)}
        slope = float(np.linalg.norm(problem.evaluate(start)[1][0]))
        options: Any = {
            "ipopt.obj_scaling_factor": 1.0 / slope if 0.0 < slope < np.inf else 1.0,
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
        solver = ca.nlpsol("gait", "ipopt", parts, options)
        found = solver(x0=start, lbg=problem.lower, ubg=problem.upper)
        stats = solver.stats()
    best = np.array(found["x"]).ravel()
    return Minimum(
        best, str(stats["return_status"]), int(stats["iter_count"]), kkt_residual(problem, best)
    )


def kkt_residual(problem: Problem, z: Array, *, active: float = 1e-6) -> float:
    """Return what no forces of the active constraints can balance of ∇f, relative to f.

    |∇f + Σ λᵢ ∇cᵢ| / |f| at its least, with λ ≥ 0 at upper bounds and ≤ 0 at lower ones, by
    bounded least squares.  It knows nothing of how z was found.
    """
    from scipy.optimize import lsq_linear

    values, slopes = problem.evaluate(z)
    if not (np.isfinite(values).all() and np.isfinite(slopes).all() and values[0]):
        return np.inf
    left = slopes[0] / abs(values[0])
    at = np.concatenate([values[1:], problem.rows @ z])
    rows = np.vstack([slopes[1:], problem.rows])
    high = problem.upper - at < active * np.maximum(1.0, np.abs(at))
    low = at - problem.lower < active * np.maximum(1.0, np.abs(at))
    norms = np.linalg.norm(rows, axis=1)
    use = (high | low) & (norms > 0.0)
    if use.any():
        bounds = np.where(low[use], -np.inf, 0.0), np.where(high[use], np.inf, 0.0)
        left = lsq_linear((rows[use] / norms[use, None]).T, -left, bounds, tol=1e-14).fun
    return float(np.linalg.norm(left))


class _Function(ca.Callback):
    """The objective and the constraints as a function that CasADi calls."""

    def __init__(self, problem: Problem, stopped: Callable[[], bool]) -> None:
        ca.Callback.__init__(self)
        self._problem, self._stopped = problem, stopped
        self._last: tuple[Array, tuple[Array, Array]] | None = None
        self.construct("gait", {})

    def at(self, z: Array) -> tuple[Array, Array]:
        """Return values and derivatives; NaN after Ctrl-C, which ends the search."""
        if self._last is None or not np.array_equal(self._last[0], z):
            values, slopes = self._problem.evaluate(z)
            self._last = z.copy(), (values, slopes)
        values, slopes = self._last[1]
        return (np.full_like(values, np.nan), slopes) if self._stopped() else (values, slopes)

    def get_n_in(self) -> int:
        return 1

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, _: int) -> Any:
        return ca.Sparsity.dense(self._problem.size, 1)

    def get_sparsity_out(self, _: int) -> Any:
        return ca.Sparsity.dense(1 + self._problem.constraints, 1)

    def eval(self, given: Any) -> Any:
        return [self.at(np.array(given[0]).ravel())[0]]

    def has_jacobian(self) -> bool:
        return True

    def get_jacobian(self, name: str, *_: Any) -> Any:
        self._jacobian = _Jacobian(name, self)  # CasADi keeps no reference
        return self._jacobian


class _Jacobian(ca.Callback):
    """The derivatives of the same."""

    def __init__(self, name: str, function: _Function) -> None:
        ca.Callback.__init__(self)
        self._function = function
        self.construct(name, {})

    def get_n_in(self) -> int:
        return 2

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, k: int) -> Any:
        f = self._function
        return f.get_sparsity_out(0) if k else f.get_sparsity_in(0)

    def get_sparsity_out(self, _: int) -> Any:
        f = self._function
        return ca.Sparsity.dense(f.get_sparsity_out(0).size1(), f.get_sparsity_in(0).size1())

    def eval(self, given: Any) -> Any:
        return [self._function.at(np.array(given[0]).ravel())[1]]
