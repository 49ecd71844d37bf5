"""SciPy's integrators over any vector field on the full state."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.integrate import ode, odeint, solve_ivp

from ....common.arrays import Array
from ....common.errors import IntegrationError
from ....common.waiting import held_interrupt
from ..problems import Problem
from ..solver import ATOL, End, PreparedRun, Solver, decades

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
