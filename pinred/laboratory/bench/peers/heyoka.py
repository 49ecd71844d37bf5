"""heyoka's Taylor integrator on pinred's reduced equations, for one member or a batch."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import cache, partial
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import casadi as ca
import numpy as np

from ....common.arrays import Array
from ....common.errors import IntegrationError, UnsupportedOperationError
from ....kernels.reduced_graph import ReducedGraph
from ..problems import PreparedRun, Problem, Solver, compile_members, decades
from .aba import INSTALL


def has_heyoka() -> bool:
    """Return whether heyoka is installed."""
    return find_spec("heyoka") is not None


def reduced_graph(problem: Problem) -> ca.Function:
    """Return the reduced vector field that pinred compiles, as a CasADi Function."""
    return ReducedGraph(problem.system, problem.flow.kernel.structure).rate()


def taylor_expressions(function: ca.Function, parameters: Sequence[Any]) -> list[tuple[Any, Any]]:
    """Translate a CasADi Function (y, parameters) → dy/dt to heyoka expressions.

    Numbers in `parameters` become constants, and constant subexpressions are folded. Expressions in
    `parameters` stay symbolic.

    Args:
        function: The CasADi Function.
        parameters: Numbers or heyoka expressions.
    Returns:
        Pairs (yᵢ, dyᵢ/dt).
    Raises:
        UnsupportedOperationError: heyoka lacks an operation of the function.
    """
    hy = import_module("heyoka")
    y = [hy.expression(f"y{k}") for k in range(function.numel_in(0))]
    inputs: list[Sequence[Any]] = [y, list(parameters)]
    rate: list[Any] = [0.0] * function.numel_out(0)
    expressions: dict[int, Any] = {}
    operations = _operations()
    for k in range(function.n_instructions()):
        op, source = function.instruction_id(k), function.instruction_input(k)
        target = function.instruction_output(k)
        if op == ca.OP_OUTPUT:
            rate[target[1]] = expressions[source[0]]
        elif op == ca.OP_INPUT:
            expressions[target[0]] = inputs[source[0]][source[1]]
        elif op == ca.OP_CONST:
            expressions[target[0]] = float(function.instruction_constant(k))
        elif op in operations:
            expressions[target[0]] = operations[op](*(expressions[i] for i in source))
        else:
            raise UnsupportedOperationError(
                f"instruction {k} of '{function.name()}' has no translation to heyoka; add it to "
                "pinred/laboratory/bench/peers/heyoka.py"
            )
    return [
        (v, hy.expression(f) if isinstance(f, float) else f) for v, f in zip(y, rate, strict=True)
    ]


@cache
def _operations() -> dict[int, Any]:
    """Return a mapping: CasADi operation code → function of numbers or heyoka expressions."""
    hy = import_module("heyoka")

    def function(name: str) -> Any:
        apply = getattr(hy, name)
        return lambda a: apply(hy.expression(a)) if isinstance(a, float) else apply(a)

    return {
        ca.OP_ADD: lambda a, b: a + b,
        ca.OP_SUB: lambda a, b: a - b,
        ca.OP_MUL: lambda a, b: a * b,
        ca.OP_DIV: lambda a, b: a / b,
        ca.OP_NEG: lambda a: -a,
        ca.OP_SQ: lambda a: a * a,
        ca.OP_TWICE: lambda a: 2.0 * a,
        ca.OP_INV: lambda a: 1.0 / a,
        ca.OP_ASSIGN: lambda a: a,
        ca.OP_SIN: function("sin"),
        ca.OP_COS: function("cos"),
        ca.OP_SQRT: function("sqrt"),
    }


MOST_UNROLLED = 300  # largest number of instructions that heyoka unrolls within seconds


def _prepare(problem: Problem, tolerance: float, *, unrolled: bool) -> PreparedRun:
    flow, duration = problem.flow, problem.start.duration
    began = time.perf_counter()
    expressions = taylor_expressions(reduced_graph(problem), flow.parameters.tolist())
    # Unrolled code runs up to four times as fast, but takes minutes to compile for a quadruped.
    ta = import_module("heyoka").taylor_adaptive(
        expressions, flow.y0.tolist(), tol=tolerance, compact_mode=not unrolled
    )
    build = time.perf_counter() - began

    def run() -> Any:
        ta.time = 0.0
        ta.state[:] = flow.y0
        outcome, _, _, steps, *_ = ta.propagate_until(duration)
        if outcome.name != "time_limit":
            raise IntegrationError(f"heyoka stopped with {outcome.name} at t = {ta.time:g} s")
        return steps

    return PreparedRun(run, lambda steps: problem.end(np.array(ta.state), int(steps)), build)


def _missing(problem: Problem, unrolled: str = "") -> str:
    """Return why heyoka, or its method with unrolled code of this name, is left out."""
    if not has_heyoka():
        return f"heyoka is left out: {INSTALL}"
    if unrolled and reduced_graph(problem).n_instructions() > MOST_UNROLLED:
        return f"{unrolled} is left out: it takes minutes to compile"
    return ""


def _prepare_batch(members: Sequence[Problem], tolerance: float, *, unrolled: bool) -> PreparedRun:
    hy = import_module("heyoka")
    flows, end = compile_members(members), members[0].start.duration
    width = hy.recommended_simd_size()
    parameters = [hy.par[k] for k in range(flows.parameters.shape[1])]
    expressions = taylor_expressions(reduced_graph(members[0]), parameters)
    order = np.arange(-(-len(members) // width) * width).clip(max=len(members) - 1)
    starts = [np.ascontiguousarray(flows.y0[order[k : k + width]].T) for k in order[::width]]
    numbers = [
        np.ascontiguousarray(flows.parameters[order[k : k + width]].T) for k in order[::width]
    ]
    ta = hy.taylor_adaptive_batch(
        expressions, starts[0].copy(), tol=tolerance, compact_mode=not unrolled,
        pars=numbers[0].copy(),
    )  # fmt: skip

    def run() -> Array:
        final_states_of_groups = []
        for y0, pars in zip(starts, numbers, strict=True):
            ta.set_time(0.0)
            ta.state[:], ta.pars[:] = y0, pars
            ta.propagate_until(end)
            if any(outcome[0].name != "time_limit" for outcome in ta.propagate_res):
                raise IntegrationError("heyoka did not integrate all members to their end")
            final_states_of_groups.append(ta.state.T.copy())
        return np.concatenate(final_states_of_groups)[: len(members)]

    return PreparedRun(run, lambda y, member: members[member].end(y[member]))


def _solvers(
    name: str,
    texts: tuple[str, str],
    tolerances: tuple[tuple[float, ...], tuple[float, ...]],
    prepare: Callable[..., PreparedRun],
) -> tuple[Solver, Solver]:
    """Return methods with compact code and with unrolled code."""
    unrolled = f"{name}-unrolled"
    missing = partial(_missing, unrolled=unrolled)
    return (
        Solver(name, texts[0], tolerances[0], partial(prepare, unrolled=False), _missing),
        Solver(unrolled, texts[1], tolerances[1], partial(prepare, unrolled=True), missing),
    )


HEYOKA = _solvers(
    "heyoka",
    (
        "Taylor, propagation alone, pinred's reduced equations in compact mode",
        "the same without compact mode",
    ),
    (decades(2, 15, 2), decades(2, 14, 3)),
    _prepare,
)
HEYOKA_BATCH = _solvers(
    "heyoka-batch",
    ("Taylor in batch mode, compact", "the same, unrolled"),
    (decades(7, 14), decades(7, 14)),
    _prepare_batch,
)
