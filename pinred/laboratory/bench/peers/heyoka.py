"""heyoka's Taylor integrator on pinred's reduced equations, in double precision."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from ....common.errors import IntegrationError
from ....system.state_fields import with_base
from ..problems import Problem
from ..solver import End, PreparedRun, Solver, decades
from ..taylor import has_heyoka, reduced_graph, taylor_integrator
from .equality import INSTALL

MOST_UNROLLED = 300  # largest number of instructions that heyoka unrolls within seconds


def _prepare(problem: Problem, tolerance: float, *, unrolled: bool) -> PreparedRun:
    from ....simulation.compiled.compiled_flow import CompiledFlow
    from ....simulation.plan import plan_of

    scene = problem.scene()
    flow = CompiledFlow.of_plan(plan_of(scene))
    began = time.perf_counter()
    ta = taylor_integrator(
        reduced_graph(problem), flow.parameters.tolist(), flow.y0, tolerance, unrolled=unrolled
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
        reduced = flow.states(scene.report_times, np.array([ta.state]))
        states = with_base(reduced, scene.system.name)
        return End(states.x[0], states.q[0], states.v[0], int(steps))

    return PreparedRun(run, end, build)


def _not_installed(_: Problem) -> str:
    return "" if has_heyoka() else f"heyoka is left out: {INSTALL}"


def _long_to_unroll(problem: Problem) -> str:
    if has_heyoka() and (size := reduced_graph(problem).n_instructions()) > MOST_UNROLLED:
        return (
            f"heyoka-unrolled is left out: compiling {size} instructions takes minutes; "
            "--full includes it"
        )
    return _not_installed(problem)


def _unrolled(missing: Callable[[Problem], str]) -> Solver:
    return Solver(
        "heyoka-unrolled",
        "the same without compact mode",
        decades(2, 14, 3),
        partial(_prepare, unrolled=True),
        missing,
    )


HEYOKA = (
    Solver(
        "heyoka",
        "Taylor, propagation alone, pinred's reduced equations in compact mode",
        decades(2, 15, 2),
        partial(_prepare, unrolled=False),
        _not_installed,
    ),
    _unrolled(_long_to_unroll),
)
HEYOKA_SLOW = (HEYOKA[0], _unrolled(_not_installed))
