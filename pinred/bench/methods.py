"""The methods whose accuracy is measured.  A further one is one more entry of METHODS."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from ..arrays import Array
from ..errors import IntegrationError
from ..state import with_base
from .full_field import full_field
from .problems import Problem
from .taylor import INSTALL, has_heyoka, taylor_integrator

QUICK = 300  # instructions that heyoka unrolls in seconds
ATOL = 0.01  # absolute tolerance, in parts of the relative one, where a method takes both


@dataclass(frozen=True)
class End:
    """The end of a motion.  x: (m,) shape, unwrapped.  q: (nq,).  evaluations: see Method."""

    x: Array
    q: Array
    evaluations: int


@dataclass(frozen=True)
class Prepared:
    """A method ready to run a problem at a tolerance.

    run: what is timed, from the initial values to the end; raises IntegrationError if it
    does not get there.  end: takes what `run` returns; not timed.  build: s before, once.
    """

    run: Callable[[], Any]
    end: Callable[[Any], End]
    build: float = 0.0


@dataclass(frozen=True)
class Method:
    """A way to solve a problem.

    about: what is timed.  tolerances: those at which it is measured.  missing: says of a
    problem why the method is not run, "" if it is.  Its evaluations are of the vector field,
    or steps if it is Taylor's.
    """

    name: str
    about: str
    tolerances: tuple[float, ...]
    prepare: Callable[[Problem, float], Prepared]
    missing: Callable[[Problem], str] = lambda _: ""


def _pinred(problem: Problem, tolerance: float) -> Prepared:
    from ..simulation import simulate

    start, times = problem.start, problem.times

    def run() -> Any:
        traj = simulate(
            problem.system,
            x0=start.x,
            xdot0=start.xdot,
            xi0=start.xi,
            times=times,
            rtol=tolerance,
            atol=ATOL * tolerance,
        )
        return traj.states, traj.run.evaluations

    return Prepared(run, lambda found: End(found[0].x[0], found[0].q[0], found[1]))


def _pinred_integration(problem: Problem, tolerance: float) -> Prepared:
    from ..engine.flow import CompiledFlow
    from ..engine.run import solve

    scene = problem.scene(tolerance, ATOL * tolerance)
    flow = CompiledFlow(scene)

    def end(found: Any) -> End:
        times = scene.report_times
        states = with_base(flow.states(times, found.at(times), flow.numbers), scene.system.name)
        return End(states.x[0], states.q[0], found.evaluations)

    integrate = solve(flow, scene, None)
    return Prepared(lambda: integrate(0.0, scene.end, flow.y0), end)


def _scipy(problem: Problem, tolerance: float) -> Prepared:
    rate, y0 = full_field(problem.system), problem.full_start()
    size, m = problem.system.group.size, problem.system.m
    span = (0.0, problem.start.duration)

    def run() -> Any:
        found = solve_ivp(rate, span, y0, method="DOP853", rtol=tolerance, atol=ATOL * tolerance)
        if not found.success:
            raise IntegrationError(found.message)
        return found

    def end(found: Any) -> End:
        y = found.y[:, -1]
        return End(y[size : size + m], problem.full.q(y), int(found.nfev))

    return Prepared(run, end)


def _heyoka(problem: Problem, tolerance: float, *, unrolled: bool) -> Prepared:
    from ..engine.flow import CompiledFlow

    scene = problem.scene(1e-10, 1e-12)  # its tolerances are not used
    flow = CompiledFlow(scene)
    began = time.perf_counter()
    ta = taylor_integrator(
        _graph(problem), flow.parameters.tolist(), flow.y0, tolerance, unrolled=unrolled
    )
    build = time.perf_counter() - began

    def run() -> Any:
        ta.time = 0.0
        ta.state[:] = flow.y0
        outcome, _, _, steps, *_ = ta.propagate_until(scene.end)
        if outcome.name != "time_limit":
            raise IntegrationError(f"heyoka stopped with {outcome.name} at t = {ta.time:g} s")
        return steps

    def end(steps: Any) -> End:
        reduced = flow.states(scene.report_times, np.array([ta.state]), flow.numbers)
        states = with_base(reduced, scene.system.name)
        return End(states.x[0], states.q[0], int(steps))

    return Prepared(run, end, build)


def _graph(problem: Problem) -> Any:
    """Return the CasADi Function of the reduced vector field that pinred compiles."""
    from ..engine.flow import CompiledFlow
    from ..engine.symbolic import ReducedGraph

    kernel = CompiledFlow(problem.scene(1e-10, 1e-12)).kernel
    return ReducedGraph(problem.system, kernel.structure).rate()


def _no_heyoka(_: Problem) -> str:
    return "" if has_heyoka() else f"heyoka is left out: {INSTALL}"


def _long_to_unroll(problem: Problem) -> str:
    if has_heyoka() and (size := _graph(problem).n_instructions()) > QUICK:
        return (
            f"heyoka, unrolled is left out: {size} instructions take it minutes to compile; "
            "--slow takes it in"
        )
    return "" if has_heyoka() else _no_heyoka(problem)


def _decades(first: int, last: int) -> tuple[float, ...]:
    return tuple(float(f"1e-{k}") for k in range(first, last + 1))


METHODS = (
    Method("pinred", "simulate(), whole call from initial values", _decades(1, 13), _pinred),
    Method(
        "pinred, inside",
        "its integration alone: as heyoka is timed",
        _decades(1, 13),
        _pinred_integration,
    ),
    Method("SciPy", "solve_ivp, DOP853 over pin.aba on (q, v)", _decades(1, 13), _scipy),
    Method(
        "heyoka",
        "Taylor, propagation alone, pinred's reduced equations in compact mode",
        _decades(1, 15),
        partial(_heyoka, unrolled=False),
        _no_heyoka,
    ),
    Method(
        "heyoka, unrolled",
        "the same without compact mode",
        _decades(1, 15)[::2],
        partial(_heyoka, unrolled=True),
        _long_to_unroll,
    ),
)
SLOW_METHODS = (*METHODS[:-1], replace(METHODS[-1], missing=_no_heyoka))
