"""Pinocchio's ABA called from Python, and what all peers with full models share.

The model of another tool is timed only if its mass matrix and accelerations equal Pinocchio's.
SciPy's integrators run over the vector field of any model.

ABA is integrated by hand-written methods and by SciPy's. The methods with fixed steps integrate
Pinocchio's (q, v) with pin.integrate. SciPy's methods integrate the state (root, x, v) of
judge/reference_solution.py. The judge's vector field takes ten times as long as `pin.aba` and would
make SciPy's methods look slow. The field here allocates no array except its result and computes the
kinematics of the root with Python floats.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from importlib.util import find_spec
from math import cos, sin
from typing import Any, Protocol

import numpy as np
import pinocchio as pin
from scipy.integrate import ode, odeint, solve_ivp

from ....common.arrays import Array
from ....common.errors import IntegrationError, UnsupportedOperationError, install_command
from ....common.waiting import held_interrupt
from ....judge.full_system import root_motion
from ....lie.group import Group
from ....reduction.pointwise_reduction import symmetric
from ....system.system import System
from ..problems import ATOL, UNKNOWN, End, PreparedRun, Problem, Solver, decades, halvings, steps_of

INSTALL = install_command("bench")
EQUAL = 1e-9  # largest relative difference that counts as equal
_STATES = 5


class Bridge(Protocol):
    """A peer's model of a system, in Pinocchio's coordinates."""

    def mass_matrix(self, q: Array) -> Array:
        """Return the mass matrix (n, n) with respect to Pinocchio's velocities."""

    def acceleration(self, q: Array, v: Array) -> Array:
        """Return Pinocchio's dv/dt without torques, (n,)."""


@dataclass(frozen=True)
class Equality:
    """Largest differences from Pinocchio, relative to the largest entry.

    Attributes:
        mass: Difference of the mass matrix; NaN if the peer has none.
        acceleration: Difference of dv/dt.
    """

    mass: float
    acceleration: float

    @property
    def holds(self) -> bool:
        """Whether both differences are small; a missing mass matrix is ignored."""
        worst = np.nanmax([self.mass, self.acceleration])
        return bool(np.isfinite(self.acceleration) and worst <= EQUAL)


def equality(system: System, bridge: Bridge) -> Equality:
    """Compare a peer's model of a system with Pinocchio's."""
    model, data = system.model, system.model.createData()
    rng = np.random.default_rng(0)
    mass, acceleration = [], []
    for _ in range(_STATES):
        pose = system.group.exp(rng.normal(size=system.r))
        q = system.q(pose, rng.uniform(-1.0, 1.0, system.m))
        v = rng.normal(size=system.n)
        mass.append(_relative(bridge.mass_matrix(q), symmetric(pin.crba(model, data, q))))
        expected = pin.aba(model, data, q, v, np.zeros(system.n))
        acceleration.append(_relative(bridge.acceleration(q, v), np.array(expected)))
    return Equality(float(np.max(mass)), float(np.max(acceleration)))


def no_mass_matrix(system: System) -> Array:
    """Return a matrix of NaN, for peers without a mass matrix."""
    return np.full((system.n, system.n), UNKNOWN)


def missing_unless_equal(
    package: str, label: str, bridge: Callable[[System], Bridge]
) -> Callable[[Problem], str]:
    """Return a function that says why a peer cannot run a problem; "" if it can."""

    @cache
    def why(system: System) -> str:
        try:
            differences = equality(system, bridge(system))
        except UnsupportedOperationError as error:
            return f"{label} is left out: {error}"
        if differences.holds:
            return ""
        return (
            f"{label} is not timed: its model is not Pinocchio's; mass matrix and accelerations "
            f"differ by {differences.mass:.1e} and {differences.acceleration:.1e}, relative"
        )

    def missing(problem: Problem) -> str:
        if find_spec(package) is None:
            return f"{label} is left out: {INSTALL}"
        return why(problem.system)

    return missing


def _relative(actual: Array, expected: Array) -> float:
    """Return the largest difference, relative to the largest expected entry unless that is 0."""
    return float(np.abs(actual - expected).max() / (np.abs(expected).max() or 1.0))


def root_rotation(system: System, q: Array) -> Array:
    """Return the matrix (k, k) that rotates the root's linear velocity from body to fixed axes."""
    k, pose = system.group.linear, system.configuration(q).pose
    return system.group.Ad(pose)[:k, :k]


def frame_rotation_term(system: System, v: Array) -> Array:
    """Return ω × v of the root, (k,): the acceleration due to the rotation of body axes."""
    axes, k = list(system.group.axes), system.group.linear
    twist = np.zeros(6)
    twist[axes] = v[: system.r]
    return np.asarray(np.cross(twist[3:], twist[:3])[axes[:k]])


_MOST = 100_000_000  # largest number of steps
Rate = Callable[[float, Array], Array]


@dataclass(frozen=True)
class Field:
    """A vector field on the full state.

    Attributes:
        rate: Function (t, y) → dy/dt.
        y0: Initial state.
        end: Function (y, evaluations) → final state in Pinocchio's coordinates.
    """

    rate: Rate
    y0: Array
    end: Callable[[Array, float], End]


def by_solve_ivp(field: Field, problem: Problem, tolerance: float, method: str) -> PreparedRun:
    """Prepare `solve_ivp` with DOP853 or LSODA."""
    span = (0.0, problem.start.duration)

    def run() -> Any:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            solution = solve_ivp(
                field.rate, span, field.y0, method=method, rtol=tolerance, atol=ATOL * tolerance
            )
        if not solution.success:
            raise IntegrationError(solution.message)
        return solution

    return PreparedRun(run, lambda solution: field.end(solution.y[:, -1], float(solution.nfev)))


def by_ode(field: Field, problem: Problem, tolerance: float, method: str) -> PreparedRun:
    """Prepare `ode` with Hairer's dop853."""
    duration = problem.start.duration

    def run(rate: Rate = field.rate) -> Array:
        solver = ode(rate).set_integrator(
            method, rtol=tolerance, atol=ATOL * tolerance, nsteps=_MOST
        )
        with held_interrupt() as stopped, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # failures raise an error below
            solver.set_solout(lambda *_: -1 if stopped() else 1)
            solver.set_initial_value(field.y0, 0.0)
            y = solver.integrate(duration)
        if not solver.successful():
            raise IntegrationError(f"{method} stopped with code {solver.get_return_code()}")
        return np.asarray(y)

    def end(y: Array) -> End:
        count = 0

        def counted(t: float, y: Array) -> Array:
            nonlocal count
            count += 1
            return field.rate(t, y)

        run(counted)  # `ode` does not report its evaluations
        return field.end(y, count)

    return PreparedRun(run, end)


def by_odeint(field: Field, problem: Problem, tolerance: float) -> PreparedRun:
    """Prepare `odeint` (LSODA in Fortran)."""
    times = np.array([0.0, problem.start.duration])

    def run() -> Any:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # failures raise an error below
            y, about = odeint(
                field.rate,
                field.y0,
                times,
                tfirst=True,
                rtol=tolerance,
                atol=ATOL * tolerance,
                mxstep=_MOST,
                full_output=True,
            )
        if about["message"] != "Integration successful.":
            raise IntegrationError(about["message"])
        return y[-1], float(about["nfe"][-1])

    return PreparedRun(run, lambda result: field.end(*result))


def scipy_methods(
    prefix: str,
    by: str,
    field: Callable[[Problem], Field],
    missing: Callable[[Problem], str] = lambda _: "",
) -> tuple[Solver, ...]:
    """Return benchmark methods for SciPy's integrators over one vector field.

    Args:
        prefix: Prefix of the method names.
        by: Name of the function that evaluates the vector field; used in descriptions.
        field: Function that creates the vector field of a problem.
        missing: Function that returns why a problem cannot be run; "" if it can.
    Returns:
        One method for each integrator.
    """
    drivers: dict[str, tuple[str, Callable[[Field, Problem, float], PreparedRun]]] = {
        "dop853": ("solve_ivp with DOP853", partial(by_solve_ivp, method="DOP853")),
        "lsoda": ("solve_ivp with LSODA", partial(by_solve_ivp, method="LSODA")),
        "ode-dop853": ("ode with Hairer's dop853", partial(by_ode, method="dop853")),
        "odeint": ("odeint", by_odeint),
    }

    def method(
        name: str, text: str, driver: Callable[[Field, Problem, float], PreparedRun]
    ) -> Solver:
        def prepare(problem: Problem, tolerance: float) -> PreparedRun:
            return driver(field(problem), problem, tolerance)

        return Solver(
            f"{prefix}-{name}", f"SciPy's {text} over {by}", decades(2, 13), prepare, missing
        )

    return tuple(method(name, *driver) for name, driver in drivers.items())


Floats = Sequence[float]


def full_vector_field(system: System) -> Callable[[float, Array], Array]:
    """Return the vector field (t, y) → dy/dt of a system under gravity alone."""
    model, data = system.model, system.model.createData()
    size, r, first_v = system.group.size, system.r, system.group.size + system.m
    tau = np.zeros(system.n)
    # The judge's rate of a planar root calls numpy, which is slow for single numbers.
    root_rate = _planar_rate if system.group.plane else root_motion(model).rate
    circles = _circles(system)
    has_circles = any(circles)
    aba, empty = pin.aba, np.empty
    buffer = np.empty(model.nq)

    def rate(t: float, y: Array) -> Array:  # noqa: ARG001
        ydot = empty(y.shape)
        v = y[first_v:]
        if has_circles:
            q = buffer
            entries: list[float] = []
            for coordinate, circle in zip(y[:first_v].tolist(), circles, strict=True):
                entries += (cos(coordinate), sin(coordinate)) if circle else (coordinate,)
            q[:] = entries
        else:
            q = y[:first_v]
        ydot[:size] = root_rate(y[:size].tolist(), v[:r].tolist())
        ydot[size:first_v] = v[r:]
        ydot[first_v:] = aba(model, data, q, v, tau)
        return ydot

    return rate


def _circles(system: System) -> list[bool]:
    """Return whether Pinocchio stores each coordinate of (root, x) as cosine and sine."""
    joints = system.model.joints
    root = [False] * system.group.size
    root[-1] = joints[1].nq > system.group.size
    return root + [joints[i].nq == 2 for i in range(2, system.model.njoints)]


def _planar_rate(root: Floats, v: Floats) -> Floats:
    c, s = cos(root[-1]), sin(root[-1])
    *across, x, y, w = v
    return *across, c * x - s * y, s * x + c * y, w


Tangent = Callable[[Array, Array], Array]
Step = Callable[
    [Array, Array], tuple[Array, Array]
]  # functions (q, v) → increment of q in its tangent space, and new v
State = tuple[Array, Array, Array]  # q, x, v
Preparing = Callable[[Problem, float], PreparedRun]


def aba_field(problem: Problem) -> Field:
    """Return the vector field of a problem, evaluated by pin.aba."""
    size, m = problem.system.group.size, problem.system.m

    def end(y: Array, evaluations: float) -> End:
        return End(y[size : size + m], problem.full.q(y), y[size + m :], evaluations)

    return Field(full_vector_field(problem.system), problem.full_start(), end)


def _stepped(scheme: Callable[[Problem, float], Step], stages: int) -> Preparing:
    """Return the `prepare` function of a method with fixed steps."""

    def prepare(problem: Problem, fraction: float) -> PreparedRun:
        count, model, r = steps_of(fraction), problem.system.model, problem.system.r
        step = scheme(problem, problem.start.duration / count)
        start = (problem.q0, problem.start.x, problem.v0)

        def run() -> State:
            q, x, v = start
            with np.errstate(all="ignore"):  # overflow is detected in the final state
                for _ in range(count):
                    u, v = step(q, v)
                    q, x = pin.integrate(model, q, u), x + u[r:]
            return q, x, v

        def end(state: State) -> End:
            q, x, v = state
            return End(x, q, v, float(stages * count))

        return PreparedRun(run, end)

    return prepare


def _euler(problem: Problem, h: float) -> Step:
    """Return the step of semi-implicit Euler, which updates q with the new velocity."""
    model, data, tau = _workspace(problem)

    def step(q: Array, v: Array) -> tuple[Array, Array]:
        v = v + h * pin.aba(model, data, q, v, tau)
        return h * v, v

    return step


def _rk4(problem: Problem, h: float, *, corrected: bool) -> Step:
    """Return the step of the classical Runge–Kutta method on (q, v).

    corrected: apply dexp⁻¹ (Munthe-Kaas). Without it, body velocities of different stages are
    added although they refer to different frames, and the order drops to 2 if the base rotates.
    """
    model, data, tau = _workspace(problem)
    correct = _correction(problem.system.group) if corrected else None
    aba, integrate = pin.aba, pin.integrate

    def step(q: Array, v: Array) -> tuple[Array, Array]:
        a1 = aba(model, data, q, v, tau).copy()
        k1 = v
        u = 0.5 * h * k1
        v2 = v + 0.5 * h * a1
        a2 = aba(model, data, integrate(model, q, u), v2, tau).copy()
        k2 = correct(u, v2) if correct else v2
        u = 0.5 * h * k2
        v3 = v + 0.5 * h * a2
        a3 = aba(model, data, integrate(model, q, u), v3, tau).copy()
        k3 = correct(u, v3) if correct else v3
        u = h * k3
        v4 = v + h * a3
        a4 = aba(model, data, integrate(model, q, u), v4, tau)
        k4 = correct(u, v4) if correct else v4
        h6 = h / 6.0
        return h6 * (k1 + 2.0 * (k2 + k3) + k4), v + h6 * (a1 + 2.0 * (a2 + a3) + a4)

    return step


def _workspace(problem: Problem) -> tuple[pin.Model, pin.Data, Array]:
    model = problem.system.model
    return model, model.createData(), np.zeros(model.nv)


def _planar_bracket(a: Array, b: Array) -> Array:
    bracket = np.zeros(len(a))
    bracket[-3], bracket[-2] = b[-1] * a[-2] - a[-1] * b[-2], a[-1] * b[-3] - b[-1] * a[-3]
    return bracket


def _free_bracket(a: Array, b: Array) -> Array:
    return np.asarray(pin.Motion(a).cross(pin.Motion(b)).vector)


def _dexp_inverse(bracket: Callable[[Array, Array], Array], r: int) -> Tangent:
    """Return (u, v) → du/dt, to fourth order in u, where q = q0 ⊕ u has velocity v.

    Joint motions commute, so only the root (the first r entries) is corrected.
    """

    def correct(u: Array, v: Array) -> Array:
        a, udot = u[:r], v.copy()
        first = bracket(a, v[:r])
        udot[:r] += 0.5 * first + bracket(a, first) / 12.0
        return udot

    return correct


def _correction(group: Group) -> Tangent | None:
    """Return dexp⁻¹ of a group, or None if its motions commute."""
    if group.turns == 3:
        return _dexp_inverse(_free_bracket if group.linear else np.cross, group.dim)
    return _dexp_inverse(_planar_bracket, group.dim) if group.plane else None


_STEPS = halvings(50, 14)

ABA = (
    *(
        Solver(
            f"aba-{name}", f"pin.aba and {text} in Python, equal steps", _STEPS,
            _stepped(scheme, stages), fixed=True,
        )
        for name, text, scheme, stages in (
            ("euler", "semi-implicit Euler", _euler, 1),
            ("rk4", "classical RK4 with pin.integrate", partial(_rk4, corrected=False), 4),
            ("rkmk4", "RK4 of Munthe-Kaas", partial(_rk4, corrected=True), 4),
        )
    ),
    *scipy_methods("aba", "pin.aba", aba_field),
)  # fmt: skip
