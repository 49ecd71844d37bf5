"""heyoka's Taylor integrator on pinred's reduced equations, instruction by instruction."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import casadi as ca

from ...common.arrays import Array
from ...common.errors import UnsupportedOperationError
from .problems import Problem


def has_heyoka() -> bool:
    """Return whether heyoka is installed."""
    return find_spec("heyoka") is not None


def reduced_graph(problem: Problem) -> ca.Function:
    """Return the reduced vector field that pinred compiles, as a CasADi Function."""
    from ...kernels.reduced_graph import ReducedGraph
    from ...simulation.compiled.compiled_flow import CompiledFlow
    from ...simulation.plan import plan_of

    kernel = CompiledFlow.of_plan(plan_of(problem.scene())).kernel
    return ReducedGraph(problem.system, kernel.structure).rate()


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
    value: dict[int, Any] = {}
    operations = _operations()
    for k in range(function.n_instructions()):
        op, source = function.instruction_id(k), function.instruction_input(k)
        target = function.instruction_output(k)
        if op == ca.OP_OUTPUT:
            rate[target[1]] = value[source[0]]
        elif op == ca.OP_INPUT:
            value[target[0]] = inputs[source[0]][source[1]]
        elif op == ca.OP_CONST:
            value[target[0]] = float(function.instruction_constant(k))
        elif op in operations:
            value[target[0]] = operations[op](*(value[i] for i in source))
        else:
            raise UnsupportedOperationError(
                f"instruction {k} of '{function.name()}' has no translation to heyoka; add it to "
                "pinred/laboratory/bench/taylor.py"
            )
    return [
        (v, hy.expression(f) if isinstance(f, float) else f) for v, f in zip(y, rate, strict=True)
    ]


def taylor_integrator(
    function: ca.Function,
    parameters: Sequence[float],
    y0: Array,
    tolerance: float,
    *,
    unrolled: bool,
) -> Any:
    """Return a `heyoka.taylor_adaptive` integrator with initial time 0.

    Args:
        function: Vector field (y, parameters) → dy/dt.
        parameters: Values of the parameters.
        y0: Initial state, (n,).
        tolerance: Tolerance of the Taylor method.
        unrolled: Unroll the code instead of heyoka's compact mode. It runs up to four times as
            fast, but takes minutes to compile for a quadruped.
    Returns:
        The integrator.
    """
    hy = import_module("heyoka")
    system = taylor_expressions(function, parameters)
    return hy.taylor_adaptive(system, y0.tolist(), tol=tolerance, compact_mode=not unrolled)


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
