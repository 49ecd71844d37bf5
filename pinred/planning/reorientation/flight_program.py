"""The flight of a robot with given momentum, as a sparse nonlinear program.

Joints follow clamped cubic splines, and the attitude is collocated by Hermite and Simpson, so a
step has a node at each end and one in its middle.  The splines satisfy the dynamics of the shape
without equations: torques and attitude rates are functions of (x, ẋ, ẍ, q) at the nodes, whose
derivatives `FlightDynamics` computes.  The initial attitude is stated relative to the target, which
is then the identity.  Ipopt solves the program with exact second derivatives.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from ...common.arrays import Array
from ...lie.rotations import hat
from ...reduction.tree.second_derivatives import InverseDynamics, Motion
from ...simulation.flow_map.flow_columns import ArrayCallback
from ...system.system import System

# Joints with limits of shapes, of rates and of torques.
Bounded: TypeAlias = tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]]
Stage: TypeAlias = Literal["search", "refine", "finish"]
_OPTIONS: dict[str, Any] = {
    "ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes", "ipopt.max_iter": 150,
    "no_nlp_grad": True,
}  # fmt: skip
# Options of Ipopt for a first guess, for a guess near a solution, and for one with multipliers.
# At the end the barrier parameter is constant, so that similar problems need few steps.
_STAGES: dict[Stage, dict[str, Any]] = {
    "search": {
        "ipopt.max_iter": 80, "ipopt.tol": 1e-3, "ipopt.constr_viol_tol": 1e-6,
        "ipopt.mu_strategy": "adaptive",
    },
    "refine": {
        "ipopt.tol": 1e-4, "ipopt.mu_init": 1e-3, "ipopt.bound_push": 1e-3,
        "ipopt.bound_frac": 1e-3, "ipopt.slack_bound_push": 1e-3, "ipopt.slack_bound_frac": 1e-3,
    },
    "finish": {
        "ipopt.tol": 2e-6, "ipopt.constr_viol_tol": 1e-9, "ipopt.mu_init": 1e-6,
        "ipopt.mu_target": 1e-6, "ipopt.warm_start_init_point": "yes",
        "ipopt.warm_start_bound_push": 1e-8, "ipopt.warm_start_mult_bound_push": 1e-8,
        "ipopt.warm_start_slack_bound_push": 1e-8,
    },
}  # fmt: skip
_GAUSS_NEWTON = 9  # number of first steps of a search that omit second derivatives
# Factors of the step in the equations of its end and of its middle, for the rates at its nodes.
_HERMITE_SIMPSON = ((1 / 6, 1 / 8), (4 / 6, 0.0), (1 / 6, -1 / 8))
# Factors in these equations of the attitudes at its nodes.
_ATTITUDES = ((-1.0, -0.5), (0.0, 1.0), (1.0, -0.5))


@dataclass(frozen=True, eq=False)
class Problem:
    """The numbers of a nonlinear program.

    Attributes:
        duration: Duration [s].
        momentum: Angular momentum about the centre of mass in the axes of the target, (turns,).
        first: Initial attitude relative to the target, (size,).
        ends: First and last shape, (m,).
        shape: Bounds of the shape, (2, m).
        speed: Bounds of the rates, (m,).
        torque: Bounds of the torques, (m,).
        on_rate: Weight of the mean sum of squared rates.
        on_torque: Weight of the mean sum of squared torques.
        on_miss: Weight of the squared final rotation to the target, which is zero if None.
    """

    duration: float
    momentum: Array
    first: Array
    ends: tuple[Array, Array]
    shape: Array
    speed: Array
    torque: Array
    on_rate: float
    on_torque: float
    on_miss: float | None = None


@dataclass(frozen=True, eq=False)
class Solution:
    """A solution of the nonlinear program.

    Attributes:
        coefficients: Coefficients of the splines, (count + 3, m).
        q: Attitudes at the nodes relative to the target, (nodes, size).
        solved: Whether Ipopt converged.
        finished: Whether it converged to the tolerance of the last stage.
        kkt: Largest entry of the gradient of the Lagrangian, relative to that of the objective.
        violation: Largest violation of an equation or a bound.
        multipliers: Multipliers of the bounds and of the equations.
        mean_torque: Mean over time of the sum of squared torques.
        mean_rate: Mean over time of the sum of squared rates.
        iterations: Number of iterations.
    """

    coefficients: Array
    q: Array
    solved: bool
    finished: bool
    kkt: float
    violation: float
    multipliers: tuple[ca.DM, ca.DM]
    mean_torque: float
    mean_rate: float
    iterations: int


class FlightProgram:
    """The nonlinear program of the flights of a robot.

    Attributes:
        dynamics: Equations of the flight.
        count: Number of steps.
        nodes: Number of nodes, 2·count + 1.
    """

    def __init__(self, system: System, count: int, bounded: Bounded) -> None:
        """Create the program; `bounded` has the joints with limits."""
        self.dynamics, self.count, self.nodes = FlightDynamics(system), count, 2 * count + 1
        self._m, self._size = system.m, self.dynamics.size
        self._bounded = [np.array(joints, dtype=int) for joints in bounded]
        self._all_coefficients = (count + 3) * self._m
        self._variables = self._all_coefficients + self.nodes * self._size
        simpson = np.tile([2.0, 4.0], count + 1)[: self.nodes]
        simpson[[0, -1]] = 1.0
        self._simpson = simpson / (6 * count)
        # Values and derivatives of the four splines of each step, at its nodes.
        knots = np.concatenate([[0.0] * 3, np.linspace(0.0, 1.0, count + 1), [1.0] * 3])
        self._splines = BSpline(knots, np.eye(count + 3), 3)
        step = np.minimum(np.arange(self.nodes) // 2, count - 1)
        self._local = step[:, None] + np.arange(4)
        at, basis = np.linspace(0.0, 1.0, self.nodes), self._splines
        rows = [basis(at), basis.derivative()(at), basis.derivative(2)(at)]
        self._basis = np.stack([np.take_along_axis(row, self._local, 1) for row in rows], 1)
        # Variables of each node: four rows of coefficients, then the attitude.
        coefficients = self._local[:, :, None] * self._m + np.arange(self._m)
        attitudes = np.arange(self.nodes * self._size).reshape(self.nodes, self._size)
        self._attitudes = self._all_coefficients + attitudes
        self._of_node = np.hstack([coefficients.reshape(self.nodes, -1), self._attitudes])
        self._jacobian_pattern, self._hessian_pattern = self._make_patterns()
        self._problem: Problem
        self._key = b""  # of the variables used last, and their states and derivatives
        self._state: Instants | None = None
        self._slopes: Slopes | None = None
        self._gauss_newton = 0  # remaining steps without second derivatives
        self._functions: list[_Function] = []
        self._solvers = {stage: self._make_solver(more) for stage, more in _STAGES.items()}

    def splines(self, coefficients: Array, duration: float) -> BSpline:
        """Return the splines of the joints over time."""
        return BSpline(self._splines.t * duration, coefficients, 3)

    def fit(self, shapes: Array) -> Array:
        """Return coefficients of clamped splines through shapes (count + 1, m)."""
        at_knots = self._splines(np.linspace(0.0, 1.0, self.count + 1))
        rows = np.vstack([at_knots, self._splines.derivative()(np.array([0.0, 1.0]))])
        rates = np.zeros((2, shapes.shape[1]))
        return np.asarray(np.linalg.solve(rows, np.vstack([shapes, rates])))

    def objective(self, problem: Problem, coefficients: Array, q: Array) -> float:
        """Return the objective of a problem."""
        self._start(problem)
        return self._objective(np.concatenate([coefficients.ravel(), q.ravel()]))

    def solve(
        self,
        problem: Problem,
        coefficients: Array,
        q: Array,
        stage: Stage,
        multipliers: tuple[ca.DM, ca.DM] | None = None,
    ) -> Solution:
        """Solve a problem.

        Args:
            problem: The problem.
            coefficients: Initial coefficients, (count + 3, m).
            q: Initial attitudes at the nodes, (nodes, size).
            stage: Quality of the guess.
            multipliers: Multipliers of a similar solution, or None.
        Returns:
            The solution, which may be infeasible.
        """
        self._start(problem)
        low, high = self._bounds_of_variables()
        lbg, ubg = self._bounds_of_equations()
        solver = self._solvers[stage]
        self._gauss_newton = _GAUSS_NEWTON if stage == "search" else 0
        warm_start = (
            {} if multipliers is None else dict(zip(("lam_x0", "lam_g0"), multipliers, strict=True))
        )
        start = np.concatenate([coefficients.ravel(), q.ravel()])
        done = solver(x0=start, lbx=low, ubx=high, lbg=lbg, ubg=ubg, **warm_start)
        for function in self._functions:
            if function.errors:
                errors, function.errors = function.errors, []
                raise errors[0]
        X, lam_g, lam_x = (np.array(done[name]).ravel() for name in ("x", "lam_g", "lam_x"))
        gradient, g, pattern = self._gradient(X), self._constraints(X), self._jacobian_pattern
        pull = self._jacobian(X) * lam_g[pattern.row]
        lagrangian = gradient + lam_x + np.bincount(pattern.column, pull, self._variables)
        excess = [lbg - g, g - ubg, low - X, X - high, np.zeros(1)]
        success = bool(solver.stats()["success"])
        return Solution(
            coefficients=X[: self._all_coefficients].reshape(-1, self._m),
            q=X[self._attitudes], solved=success, finished=success and stage == "finish",
            kkt=float(np.abs(lagrangian).max() / max(np.abs(gradient).max(), 1e-300)),
            violation=float(np.concatenate(excess).max()),
            multipliers=(done["lam_x"], done["lam_g"]),
            mean_torque=self._mean_square(self._at(X).torque),
            mean_rate=self._mean_square(self._at(X).u),
            iterations=int(solver.stats()["iter_count"]),
        )  # fmt: skip

    def _start(self, problem: Problem) -> None:
        self._problem, self._key = problem, b""

    def _bounds_of_variables(self) -> Array:
        """Return lower and upper bounds of the variables, (2, …)."""
        problem, m = self._problem, self._m
        bounds = np.full((2, self._variables), np.inf) * [[-1.0], [1.0]]
        first, last = problem.ends  # The two outer coefficients at each end have its shape.
        bounds[:, : 2 * m] = np.tile(first, 2)
        bounds[:, self._all_coefficients - 2 * m : self._all_coefficients] = np.tile(last, 2)
        bounds[:, self._attitudes[0]] = problem.first
        if problem.on_miss is None:
            bounds[:, self._final] = 0.0
        return bounds

    def _bounds_of_equations(self) -> Array:
        """Return lower and upper bounds of equations and limits, (2, …)."""
        problem = self._problem
        speed, torque = (np.array([-limit, limit]) for limit in (problem.speed, problem.torque))
        limits = zip((problem.shape, speed, torque), self._bounded, strict=True)
        return np.concatenate(
            [np.zeros((2, 2 * self.count * self._size))]
            + [np.tile(limit[:, joints], self.nodes) for limit, joints in limits],
            axis=1,
        )

    @property
    def _final(self) -> NDArray[np.intp]:
        """Indices of the final rotation: the vector of the quaternion, or the angle."""
        return np.asarray(self._attitudes[-1, : self.dynamics.turns])

    def _at(self, X: Array) -> Instants:
        """Return the states at the nodes, which are computed once for each X."""
        key = X.tobytes()
        if key != self._key or self._state is None:
            local = X[: self._all_coefficients].reshape(-1, self._m)[self._local]
            x, u, w = np.moveaxis(self._scaled_basis() @ local, 1, 0)
            momentum = self._problem.momentum
            self._state = self.dynamics.at(x, u, w, X[self._attitudes], momentum)
            self._slopes, self._key = None, key
        return self._state

    def _first(self, X: Array) -> Slopes:
        """Return the first derivatives at the nodes, which are computed once for each X."""
        state = self._at(X)
        if self._slopes is None:
            self._slopes = self.dynamics.first(state)
        return self._slopes

    def _scaled_basis(self) -> Array:
        T = self._problem.duration
        return np.asarray(self._basis / np.array([1.0, T, T**2])[:, None])

    def _on_variables(self, by: Array) -> Array:
        """Convert derivatives (nodes, k, 3m + size) by (x, ẋ, ẍ, q) to (nodes, k, 4m + size)."""
        nodes, k, m = by.shape[0], by.shape[1], self._m
        blocks = by[..., : 3 * m].reshape(nodes, k, 3, m)
        mixed = np.einsum("nak,nbam->nbkm", self._scaled_basis(), blocks).reshape(nodes, k, 4 * m)
        return np.concatenate([mixed, by[..., 3 * m :]], axis=-1)

    def _mean_square(self, values: Array) -> float:
        """Return the mean over time of the sum of squares of values (nodes, m)."""
        return float(self._simpson @ np.sum(values**2, axis=1))

    def _objective(self, X: Array) -> float:
        problem, state = self._problem, self._at(X)
        value = problem.on_torque * self._mean_square(state.torque)
        value += problem.on_rate * self._mean_square(state.u)
        if problem.on_miss is not None:
            value += problem.on_miss * float(np.sum(X[self._final] ** 2))
        return 0.5 * value

    def _gradient(self, X: Array) -> Array:
        problem, state, m = self._problem, self._at(X), self._m
        by = np.zeros((self.nodes, 3 * m + self._size))
        if problem.on_torque:
            weighted = problem.on_torque * self._simpson[:, None] * state.torque
            by += np.einsum("nt,ntz->nz", weighted, self._first(X).torque)
        by[:, m : 2 * m] += problem.on_rate * self._simpson[:, None] * state.u
        values = self._on_variables(by[:, None])[:, 0]
        gradient = np.zeros(self._variables)
        np.add.at(gradient, self._of_node, values)
        if problem.on_miss is not None:
            gradient[self._final] += problem.on_miss * X[self._final]
        return gradient

    def _constraints(self, X: Array) -> Array:
        state, h = self._at(X), self._problem.duration / self.count
        equations = np.zeros((self.count, 2, self._size))
        defects = zip(_ATTITUDES, _HERMITE_SIMPSON, strict=True)
        for k, (on_attitude, on_rate) in enumerate(defects):
            q, rate = state.q[k::2][: self.count], state.rate[k::2][: self.count]
            equations += np.array(on_attitude)[:, None] * q[:, None]
            equations -= h * np.array(on_rate)[:, None] * rate[:, None]
        motion = zip((state.x, state.u, state.torque), self._bounded, strict=True)
        limited = [values[:, joints].ravel() for values, joints in motion]
        return np.concatenate([equations.ravel(), *limited])

    def _make_patterns(self) -> tuple[_Pattern, _Pattern]:
        """Return the patterns of the Jacobian and of the upper half of the Hessian."""
        count, nodes, m, size = self.count, self.nodes, self._m, self._size
        places: list[tuple[NDArray[np.intp], NDArray[np.intp]]] = []
        equation = np.arange(count * 2 * size).reshape(count, 2, size)
        places += [(equation, self._attitudes[k::2][:count, None]) for k in range(3)]
        nodes_of = [self._of_node[k::2][:count, None, None] for k in range(3)]
        places += [(equation[..., None], columns) for columns in nodes_of]
        row = equation.size
        for kind, joints in enumerate(self._bounded):
            rows = row + np.arange(nodes * len(joints)).reshape(nodes, len(joints))
            if kind < 2:
                at = self._of_node[:, : 4 * m].reshape(nodes, 4, m)[..., joints]
                places.append((rows[:, None], at))
            else:
                places.append((rows[..., None], self._of_node[:, None]))
            row += rows.size
        jacobian = _Pattern(row, self._variables, places)
        i, j = self._of_node[:, :, None], self._of_node[:, None]
        return jacobian, _Pattern(
            self._variables, self._variables, [(i, j), (self._final, self._final)], upper=True
        )

    def _jacobian(self, X: Array) -> Array:
        slopes, h, count = self._first(X), self._problem.duration / self.count, self.count
        by_rate, values = self._on_variables(slopes.rate), []
        for factors in _ATTITUDES:
            ones = np.ones((count, 2, self._size))
            values.append((ones * np.array(factors)[:, None]).ravel())
        for k, weights in enumerate(_HERMITE_SIMPSON):
            block = by_rate[k::2][:count, None]
            values.append((-h * np.array(weights)[:, None, None] * block).ravel())
        for kind, joints in enumerate(self._bounded[:2]):
            values.append(np.repeat(self._scaled_basis()[:, kind], len(joints), axis=1).ravel())
        values.append(self._on_variables(slopes.torque[:, self._bounded[2]]).ravel())
        return self._jacobian_pattern.sums(np.concatenate(values))

    def _hessian(self, X: Array, on_objective: float, multipliers: Array) -> Array:
        problem, state, slopes = self._problem, self._at(X), self._first(X)
        m, count, joints = self._m, self.count, self._bounded[2]
        on_equations = multipliers[: count * 2 * self._size].reshape(count, 2, self._size)
        on_rate = np.zeros((self.nodes, self._size))
        for k, weights in enumerate(_HERMITE_SIMPSON):
            pulls = np.einsum("e,kes->ks", np.array(weights), on_equations)
            on_rate[k::2][:count] -= problem.duration / count * pulls
        weight = on_objective * problem.on_torque * self._simpson
        on_torque = weight[:, None] * state.torque
        if len(joints):
            on_torque[:, joints] += multipliers[-self.nodes * len(joints) :].reshape(self.nodes, -1)
        self._gauss_newton -= 1
        if self._gauss_newton < 0:
            H = self.dynamics.second(state, slopes, on_rate, on_torque)
        else:
            H = np.zeros((self.nodes, 3 * m + self._size, 3 * m + self._size))
        if problem.on_torque:
            weighted = weight[:, None, None] * slopes.torque
            H += np.swapaxes(slopes.torque, 1, 2) @ weighted
        u = np.arange(m, 2 * m)
        H[:, u, u] += on_objective * problem.on_rate * self._simpson[:, None]
        H = self._on_variables(np.swapaxes(self._on_variables(H), 1, 2))
        on_miss = np.full(self.dynamics.turns, on_objective * (problem.on_miss or 0.0))
        return self._hessian_pattern.sums(np.append(H.ravel(), on_miss))

    def _make_solver(self, options: dict[str, Any]) -> ca.Function:
        x, p = ("x", _dense(self._variables)), ("p", _dense(0))
        f, g = ("f", _dense(1)), ("g", _dense(self._jacobian_pattern.rows))
        jacobian, hessian = self._jacobian_pattern.sparsity(), self._hessian_pattern.sparsity()
        functions = {
            "nlp": _Function(
                "nlp", [x, p], [f, g], lambda X, _: [self._objective(X), self._constraints(X)]
            ),
            "grad_f": _Function(
                "nlp_grad_f", [x, p], [f, ("grad_f_x", x[1])],
                lambda X, _: [self._objective(X), self._gradient(X)],
            ),
            "jac_g": _Function(
                "nlp_jac_g", [x, p], [g, ("jac_g_x", jacobian)],
                lambda X, _: [self._constraints(X), self._jacobian(X)],
            ),
            "hess_lag": _Function(
                "nlp_hess_l", [x, p, ("lam_f", f[1]), ("lam_g", g[1])],
                [("triu_hess_gamma_x_x", hessian)],
                lambda X, _, on_f, on_g: [self._hessian(X, float(on_f[0]), on_g)],
            ),
        }  # fmt: skip
        self._functions += functions.values()
        nlp, all_options = functions.pop("nlp"), _OPTIONS | options | functions
        return ca.nlpsol("flight", "ipopt", nlp, all_options)


class _Pattern:
    """A sparse matrix in which entries with the same place are summed.

    Attributes:
        rows: Number of rows.
        row: Row of each nonzero, column after column.
        column: Column of each nonzero.
    """

    def __init__(
        self,
        rows: int,
        columns: int,
        places: list[tuple[NDArray[np.intp], NDArray[np.intp]]],
        *,
        upper: bool = False,
    ) -> None:
        """Create the pattern of entries at (rows, columns); `upper` omits those below it."""
        pairs = [np.broadcast_arrays(*place) for place in places]
        i = np.concatenate([pair[0].ravel() for pair in pairs]).astype(np.int64)
        j = np.concatenate([pair[1].ravel() for pair in pairs]).astype(np.int64)
        self._kept = np.flatnonzero(i <= j) if upper else slice(None)
        keys, self._slot = np.unique((j * rows + i)[self._kept], return_inverse=True)
        self.rows, self.row, self.column = rows, keys % rows, keys // rows
        self._columns = columns

    def sums(self, values: Array) -> Array:
        """Return the nonzeros from the values of all entries."""
        return np.asarray(np.bincount(self._slot, values[self._kept], len(self.row)), dtype=float)

    def sparsity(self) -> ca.Sparsity:
        """Return the places of the nonzeros."""
        starts = np.searchsorted(self.column, np.arange(self._columns + 1))
        return ca.Sparsity(self.rows, self._columns, starts.tolist(), self.row.tolist())


class _Function(ArrayCallback):
    """A function of flat arrays for CasADi, which reads and writes its buffers.

    Attributes:
        errors: Exceptions, which CasADi would print.
    """

    def __init__(
        self,
        name: str,
        inputs: list[tuple[str, ca.Sparsity]],
        outputs: list[tuple[str, ca.Sparsity]],
        compute: Callable[..., list[Array | float]],
    ) -> None:
        """Create the function; `compute` maps flat inputs to flat outputs."""
        self._compute = compute
        self.errors: list[BaseException] = []
        super().__init__(
            name, inputs, outputs, lambda arrays: [np.asarray(value) for value in compute(*arrays)]
        )

    def has_eval_buffer(self) -> bool:
        """Return that `eval_buffer` is the function."""
        return True

    def eval_buffer(self, arguments: Any, results: Any) -> int:
        """Compute the outputs; return 0, or 1 after an exception."""
        try:
            values = self._compute(*(_floats(value) for value in arguments))
        except BaseException as error:  # raised again after the call of the solver
            self.errors.append(error)
            return 1
        for buffer, value in zip(results, values, strict=True):
            _floats(buffer)[:] = value if buffer is not None else []
        return 0


def _floats(buffer: memoryview | None) -> Array:
    """Return a view of a buffer of CasADi; None stands for nothing."""
    return np.empty(0) if buffer is None or not buffer.nbytes else np.frombuffer(buffer)


def _dense(rows: int) -> ca.Sparsity:
    return ca.Sparsity.dense(rows, 1 if rows else 0)


@dataclass(frozen=True, eq=False)
class Instants:
    """States of a flight at N instants.

    Attributes:
        x: Shapes, (N, m).
        u: Shape rates, (N, m).
        q: Attitudes: quaternions (N, 4), or angles (N, 1).
        momentum: Angular momentum about the centre of mass in the axes of the attitudes, (turns,).
        inertia: Locked inertia, (N, r, r).
        coupling: Rows of the base and columns of the shape in the mass matrix, (N, r, m).
        twist: Base twists, (N, r).
        motion: The motion of all bodies.
        momenta: The momenta of all bodies, as wrenches at rest.
        rate: Rates of the attitudes, (N, 4) or (N, 1).
        torque: Torques, (N, m).
    """

    x: Array
    u: Array
    q: Array
    momentum: Array
    inertia: Array
    coupling: Array
    twist: Array
    motion: Motion
    momenta: Motion
    rate: Array
    torque: Array


@dataclass(frozen=True, eq=False)
class Slopes:
    """First derivatives by (x, ẋ, ẍ, q) at N instants.

    Attributes:
        base: Derivatives of the base twists and of their rates, (N, 2r, 3m + size).
        rate: Derivatives of the attitude rates, (N, size, 3m + size).
        torque: Derivatives of the torques, (N, m, 3m + size).
    """

    base: Array
    rate: Array
    torque: Array


class FlightDynamics:
    """Equations of a flight: the momentum about the centre of mass is known and conserved.

    The base twist ξ and its rate follow from H_bb ξ + H_bs ẋ = (0, RᵀL) and from zero wrench on
    the base.
    """

    def __init__(self, system: System) -> None:
        """Prepare the inverse dynamics."""
        self.system, self._inverse = system, InverseDynamics(system)
        self.r, self.m, self.turns = system.r, system.m, system.group.turns
        self.linear = system.group.linear
        self.size = 4 if self.turns == 3 else 1  # of an attitude

    def at(self, x: Array, u: Array, w: Array, q: Array, momentum: Array) -> Instants:
        """Compute twists, accelerations, attitude rates and torques; see `Instants`."""
        bodies = self._inverse.bodies(x)
        H, C = self._inverse.base_rows(bodies)
        mu = np.zeros((len(x), self.r))
        mu[:, self.linear :] = self._body_momentum(q, momentum)
        xi = _solved(H, mu - _times(C, u))
        zero, none = np.zeros_like(xi), np.zeros_like(u)
        bias = self._inverse.motion(bodies, xi, zero, u, w)
        motion = self._inverse.motion(bodies, xi, -_solved(H, bias.wrench), u, w)
        # The momentum H v is the inverse dynamics of the acceleration v at rest.
        momenta = self._inverse.motion(bodies, zero, xi, none, u)
        rate = _times(self._rate_map(q), xi[:, self.linear :])
        return Instants(x, u, q, momentum, H, C, xi, motion, momenta, rate, motion.torque)

    def rates(self, x: Array, u: Array) -> tuple[Array, Array]:
        """Return (P, a), (N, turns, turns) and (N, turns), of the angular velocities P RᵀL − a."""
        H, C = self._inverse.base_rows(self._inverse.bodies(x))
        inverse, at = np.asarray(np.linalg.inv(H), dtype=float), slice(self.linear, None)
        return inverse[:, at, at], _times(inverse, _times(C, u))[:, at]

    def attitude_rate(self, q: Array, locked: Array, drift: Array, momentum: Array) -> Array:
        """Return the rate of one attitude q from the entries of `rates`."""
        if self.turns == 1:
            return np.asarray(locked @ momentum - drift)
        x, y, z, w = q.tolist()
        R = np.array(
            [
                [w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y)],
                [2 * (x * y - w * z), w * w - x * x + y * y - z * z, 2 * (y * z + w * x)],
                [2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z],
            ]
        )  # the transpose of the rotation matrix
        a, b, c = (locked @ (R @ momentum) - drift).tolist()
        return 0.5 * np.array(
            [
                w * a + y * c - z * b, w * b + z * a - x * c, w * c + x * b - y * a,
                -x * a - y * b - z * c,
            ]
        )  # fmt: skip

    def first(self, s: Instants) -> Slopes:
        """Compute the first derivatives by (x, ẋ, ẍ, q)."""
        r, m = self.r, self.m
        wide = 3 * m + self.size
        slopes = np.zeros((len(s.q), r + m, wide))
        slopes[:, :r, :m] = self._inverse.first(s.momenta)[:, :r, 2 * r : 2 * r + m]
        slopes[:, :r, m : 2 * m] = s.coupling
        slopes[:, self.linear : r, 3 * m :] = -self._momentum_slope(s.q, s.momentum)
        twist = -np.linalg.solve(s.inertia, slopes[:, :r])
        first = self._inverse.first(s.motion)
        slopes = first[:, :, :r] @ twist
        slopes[..., : 3 * m] += first[:, :, 2 * r :]
        acceleration = -np.linalg.solve(s.inertia, slopes[:, :r])
        torque = slopes[:, r:] + np.swapaxes(s.coupling, 1, 2) @ acceleration
        rate = self._rate_map(s.q) @ twist[:, self.linear :]
        rate[..., 3 * m :] += self._rate_slope(s.twist[:, self.linear :])
        return Slopes(np.concatenate([twist, acceleration], axis=1), rate, torque)

    def second(self, s: Instants, slopes: Slopes, on_rate: Array, on_torque: Array) -> Array:
        """Compute second derivatives of weighted sums of attitude rates and torques.

        Twists and accelerations of the base are implicit functions, so their equations are added
        with the multipliers that make the sum stationary in them.

        Args:
            s: The instants.
            slopes: First derivatives.
            on_rate: Weights of the attitude rates, (N, size).
            on_torque: Weights of the torques, (N, m).
        Returns:
            Second derivatives by (x, ẋ, ẍ, q), (N, 3m + size, 3m + size).
        """
        r, m, linear = self.r, self.m, self.linear
        eta = -_solved(s.inertia, _times(s.coupling, on_torque))
        by_twist, power = self._inverse.second(s.motion, eta, on_torque)
        by_twist[:, linear:] += _times(np.swapaxes(self._rate_map(s.q), 1, 2), on_rate)
        zeta = -_solved(s.inertia, by_twist)
        _, momenta = self._inverse.second(s.momenta, zeta, np.zeros_like(on_torque))
        wide = 2 * r + 3 * m
        H = np.zeros((len(s.q), wide + self.size, wide + self.size))
        H[:, :wide, :wide] = power
        # The momenta have the twist in place of the acceleration, and ẋ in place of ẍ.
        xi, x = slice(0, r), slice(2 * r, 2 * r + m)
        u, w = slice(2 * r + m, 2 * r + 2 * m), slice(2 * r + 2 * m, wide)
        H[:, x, x] += momenta[:, x, x]
        for to, of in ((xi, slice(r, 2 * r)), (u, w)):
            H[:, x, to] += momenta[:, x, of]
            H[:, to, x] += momenta[:, of, x]
        if self.turns == 3:
            mixed = _rate_mixed(on_rate)
            H[:, wide:, linear:r] += mixed
            H[:, linear:r, wide:] += np.swapaxes(mixed, 1, 2)
            H[:, wide:, wide:] -= _momentum_second(zeta[:, linear:], s.momentum)
        cross = H[:, 2 * r :, : 2 * r] @ slopes.base
        result = H[:, 2 * r :, 2 * r :] + cross + np.swapaxes(cross, 1, 2)
        return np.asarray(
            result + np.swapaxes(slopes.base, 1, 2) @ H[:, : 2 * r, : 2 * r] @ slopes.base
        )

    def _body_momentum(self, q: Array, J: Array) -> Array:
        """Return RᵀJ, or J on a plane."""
        if self.turns == 1:
            return np.broadcast_to(J, q.shape)
        v, w = q[:, :3], q[:, 3:]
        alignment = np.sum(v * J, axis=1, keepdims=True)
        square = w**2 - np.sum(v**2, axis=1, keepdims=True)
        return np.asarray(square * J + 2.0 * v * alignment - 2.0 * w * np.cross(v, J))

    def _momentum_slope(self, q: Array, J: Array) -> Array:
        if self.turns == 1:
            return np.zeros((len(q), 1, 1))
        v, w = q[:, :3], q[:, 3:]
        alignment = np.sum(v * J, axis=1)[:, None, None]
        slope = np.empty((len(q), 3, 4))
        slope[..., :3] = 2.0 * (
            alignment * np.eye(3) + v[:, :, None] * J - J[:, None] * v[:, None]
            + w[..., None] * hat(J)
        )  # fmt: skip
        slope[..., 3] = 2.0 * (w * J - np.cross(v, J))
        return slope

    def _rate_map(self, q: Array) -> Array:
        """Return Q with q̇ = Q ω."""
        if self.turns == 1:
            return np.ones((len(q), 1, 1))
        v, w = q[:, :3], q[:, 3:, None]
        return 0.5 * np.concatenate([w * np.eye(3) + hat(v), -v[:, None]], axis=1)

    def _rate_slope(self, omega: Array) -> Array:
        if self.turns == 1:
            return np.zeros((len(omega), 1, 1))
        slope = np.zeros((len(omega), 4, 4))
        slope[:, :3, :3] = -0.5 * hat(omega)
        slope[:, :3, 3], slope[:, 3, :3] = 0.5 * omega, -0.5 * omega
        return slope


def _momentum_second(z: Array, J: Array) -> Array:
    second = np.zeros((len(z), 4, 4))
    alignment = (z @ J)[:, None, None]
    outer = z[:, :, None] * J
    second[:, :3, :3] = 2.0 * (outer + np.swapaxes(outer, 1, 2) - alignment * np.eye(3))
    second[:, 3:, 3:] = 2.0 * alignment
    second[:, :3, 3] = second[:, 3, :3] = -2.0 * np.cross(J, z)
    return second


def _rate_mixed(p: Array) -> Array:
    v, s = p[:, :3], p[:, 3:, None]
    return 0.5 * np.concatenate([-hat(v) - s * np.eye(3), v[:, None]], axis=1)


def _solved(matrices: Array, vectors: Array) -> Array:
    return np.asarray(np.linalg.solve(matrices, vectors[..., None]))[..., 0]


def _times(matrices: Array, vectors: Array) -> Array:
    return np.asarray(matrices @ vectors[..., None])[..., 0]
