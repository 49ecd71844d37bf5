"""Peers that solve the full equations: comparison of their models with Pinocchio's, and SciPy.

The model of a peer is timed only if its mass matrix and accelerations equal Pinocchio's. SciPy's
integrators run over the vector field of any of these models.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from importlib.util import find_spec
from typing import Any, Protocol

import numpy as np
import pinocchio as pin
from scipy.integrate import ode, odeint, solve_ivp

from ....common.arrays import Array
from ....common.errors import IntegrationError, UnsupportedOperationError
from ....common.interrupts import held_interrupt
from ....common.optional_packages import install_command
from ....reduction.inertia_split import symmetric
from ....system.system import System
from ..problems import ATOL, UNKNOWN, End, PreparedRun, Problem, Solver, decades

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
