"""Pinocchio's ABA called from Python, and what all peers with full models share.

The model of another tool is timed only if its mass matrix and accelerations equal Pinocchio's.
SciPy's integrators run over the vector field of any model.

ABA is integrated by SciPy's methods, on the state (root, x, v) of judge/reference_solution.py. The
judge's vector field takes ten times as long as `pin.aba` and would make them look slow. The field
here allocates no array except its result and computes the root's kinematics with Python floats.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from math import cos, sin
from typing import Any, Self, TypeAlias

import numpy as np
import pinocchio as pin
from scipy.integrate import ode, odeint, solve_ivp

from ....common.arrays import Array
from ....common.errors import IntegrationError, UnsupportedOperationError, install_command
from ....common.waiting import held_interrupt
from ....judge.full_system import root_motion
from ....reduction.pointwise_reduction import symmetric
from ....system.system import System
from ..problems import ATOL, End, PreparedRun, Problem, Solver, decades

INSTALL = install_command("bench")
EQUAL = 1e-9  # largest relative difference that counts as equal
_STATES = 5


class PeerModel:
    """A peer's model of a system, and the conversion of its velocities to Pinocchio's.

    Attributes:
        system: The system.
    """

    system: System

    def __init__(self, system: System) -> None:
        """Build the model."""
        self.system = system

    @classmethod
    def of(cls, system: System) -> Self:
        """Return the model of a system, built once for each thread."""
        return system.workspace(cls.__name__, lambda: cls(system))

    def turn(self, q: Array) -> Array:
        """Return the orthogonal matrix (n, n) that maps Pinocchio's velocities to the peer's.

        The linear velocity of the root is in fixed axes, as in MuJoCo and Drake.
        """
        T, k = np.eye(self.system.n), self.system.group.linear
        T[:k, :k] = self.system.group.Ad(self.system.configuration(q).pose)[:k, :k]
        return T

    def equations(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return the mass matrix and accelerations of the peer's velocities, without torques.

        Args:
            q: Pinocchio's configuration, (nq,).
            v: Pinocchio's velocity, (n,).
        Returns:
            (n, n), NaN if the peer has none, and (n,).
        """
        raise NotImplementedError

    def mass_matrix(self, q: Array) -> Array:
        """Return the mass matrix (n, n) with respect to Pinocchio's velocities."""
        T = self.turn(q)
        return np.asarray(T.T @ self.equations(q, np.zeros(self.system.n))[0] @ T)

    def acceleration(self, q: Array, v: Array) -> Array:
        """Return Pinocchio's dv/dt without torques, (n,)."""
        a, axes = self.turn(q).T @ self.equations(q, v)[1], list(self.system.group.axes)
        twist, k = np.zeros(6), self.system.group.linear
        twist[axes] = v[: self.system.r]
        a[:k] -= np.cross(twist[3:], twist[:3])[axes[:k]]  # due to the rotation of body axes
        return np.asarray(a)


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


def equality(system: System, peer: PeerModel) -> Equality:
    """Compare a peer's model of a system with Pinocchio's."""
    model, data = system.model, system.model.createData()
    rng = np.random.default_rng(0)
    mass, acceleration = [], []
    for _ in range(_STATES):
        pose = system.group.exp(rng.normal(size=system.r))
        q = system.q(pose, rng.uniform(-1.0, 1.0, system.m))
        v = rng.normal(size=system.n)
        mass.append(_relative(peer.mass_matrix(q), symmetric(pin.crba(model, data, q))))
        expected = pin.aba(model, data, q, v, np.zeros(system.n))
        acceleration.append(_relative(peer.acceleration(q, v), np.array(expected)))
    return Equality(float(np.max(mass)), float(np.max(acceleration)))


def missing_unless_equal(
    package: str, label: str, model: Callable[[System], PeerModel]
) -> Callable[[Problem], str]:
    """Return a function that says why a peer cannot run a problem; "" if it can."""

    @cache
    def why(system: System) -> str:
        try:
            differences = equality(system, model(system))
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


def by_solve_ivp(field: Field, problem: Problem, tolerance: float) -> PreparedRun:
    """Prepare `solve_ivp` with DOP853."""
    span = (0.0, problem.start.duration)

    def run() -> Any:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            solution = solve_ivp(
                field.rate, span, field.y0, "DOP853", rtol=tolerance, atol=ATOL * tolerance
            )
        if not solution.success:
            raise IntegrationError(solution.message)
        return solution

    return PreparedRun(run, lambda solution: field.end(solution.y[:, -1], float(solution.nfev)))


def by_ode(field: Field, problem: Problem, tolerance: float) -> PreparedRun:
    """Prepare `ode` with Hairer's dop853."""
    duration = problem.start.duration

    def run(rate: Rate = field.rate) -> Array:
        solver = ode(rate).set_integrator(
            "dop853", rtol=tolerance, atol=ATOL * tolerance, nsteps=_MOST
        )
        with held_interrupt() as stopped, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # failures raise an error below
            solver.set_solout(lambda *_: -1 if stopped() else 1)
            solver.set_initial_value(field.y0, 0.0)
            y = solver.integrate(duration)
        if not solver.successful():
            raise IntegrationError(f"dop853 stopped with code {solver.get_return_code()}")
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


Driver: TypeAlias = Callable[[Field, Problem, float], PreparedRun]


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
    drivers: dict[str, tuple[str, Driver]] = {
        "dop853": ("solve_ivp with DOP853", by_solve_ivp),
        "ode-dop853": ("ode with Hairer's dop853", by_ode),
        "odeint": ("odeint", by_odeint),
    }

    def method(name: str, text: str, driver: Driver) -> Solver:
        def prepare(problem: Problem, tolerance: float) -> PreparedRun:
            return driver(field(problem), problem, tolerance)

        about = f"SciPy's {text} over {by}"
        return Solver(f"{prefix}-{name}", about, decades(2, 13), prepare, missing)

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


def aba_field(problem: Problem) -> Field:
    """Return the vector field of a problem, evaluated by pin.aba."""
    size, m = problem.system.group.size, problem.system.m

    def end(y: Array, evaluations: float) -> End:
        return End(y[size : size + m], problem.full.q(y), y[size + m :], evaluations)

    return Field(full_vector_field(problem.system), problem.full_start(), end)


ABA = scipy_methods("aba", "pin.aba", aba_field)
