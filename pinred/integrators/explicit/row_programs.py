"""Compiled sequences of kernel calls and linear combinations of rows, with vector instructions.

An explicit method is a list of `Sum` and `Rate` steps on the rows `work` (rows, stride). The
programs below write these steps as straight-line code: without loops over stages and without
the zeros of the tableau. They serve single runs and batches in SIMD lanes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from llvmlite import ir

from ...common.arrays import Array
from ..stepping.compiling import make_intrinsic, numba_core
from ..stepping.intrinsics import VectorRows, add_pairwise, check_contiguous, emit_call
from ..stepping.run_state import WIDTH

Terms: TypeAlias = Sequence[tuple[int, float]]  # pairs of row and weight


@dataclass(frozen=True)
class Sum:
    """The linear combination: row `out` = row `base` + h Σ weight · row.

    Attributes:
        out: Row of the result.
        base: Row to which the terms are added, None for zero.
        terms: Pairs of row and weight, added as a balanced tree.
    """

    out: int
    base: int | None
    terms: Terms


@dataclass(frozen=True)
class Rate:
    """The kernel call: row `out` = rates at the state in row `at`."""

    at: int
    out: int


@dataclass(frozen=True)
class Pullback:
    """The adjoint kernel call: row `out` = (∂f/∂y)ᵀ covector, with y in row `at`.

    The derivative with respect to the parameters is added to a running sum.
    """

    at: int
    covector: int
    out: int


def row_sum(out: int, base: int | None, terms: Terms) -> Callable[[Array, float], None]:
    """Return the compiled function combine(work, h) of one linear combination (see Sum)."""

    @make_intrinsic
    def combine(typing: Any, work: Any, h: Any) -> Any:
        types = numba_core.types

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            rows = VectorRows(context, builder, signature.args[0], arguments[0], WIDTH)
            _emit_sum(builder, rows, Sum(out, base, terms), rows.splat(arguments[1]))
            return context.get_dummy_value()

        return types.void(work, types.float64), generate

    return combine


def row_program(
    steps: Sequence[Sum | Rate],
    width: int = WIDTH,
    lane_steps: Callable[[], Any] | None = None,
    flags: tuple[str, ...] = (),
) -> Callable[[int, Array, Array, Any], int]:
    """Return the compiled function run(address, params, work, h) of a list of steps.

    The function performs all steps and returns the number of kernel calls.

    Args:
        steps: Linear combinations and kernel calls, in order.
        width: Number of floats in a vector.
        lane_steps: Function that returns numba's type of h, if h is a vector with a step length
            per SIMD lane.
        flags: LLVM fast-math flags of the floating-point instructions.
    Returns:
        The function.
    """
    calls = sum(isinstance(step, Rate) for step in steps)

    @make_intrinsic
    def run(typing: Any, address: Any, params: Any, work: Any, h: Any) -> Any:
        check_contiguous(params, work)
        types = numba_core.types
        step_type = types.float64 if lane_steps is None else lane_steps()

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            address, params, work, h = arguments
            rows = VectorRows(context, builder, signature.args[2], work, width)
            numbers = context.make_array(signature.args[1])(context, builder, params).data
            scale = rows.splat(h) if lane_steps is None else h
            for step in steps:
                if isinstance(step, Rate):
                    emit_call(builder, address, [rows.at(step.at), numbers, rows.at(step.out)])
                else:
                    _emit_sum(builder, rows, step, scale, flags)
            return ir.Constant(ir.IntType(64), calls)

        return types.int64(types.int64, params, work, step_type), generate

    return run


def pullback_program(
    steps: Sequence[Sum | Pullback],
) -> Callable[[int, Array, Array, Array, Array, float], None]:
    """Return the compiled function run(adjoint, params, work, both, by_params, h).

    It performs all steps. both: (n + p,), output of the adjoint kernel. by_params: (p,), to which
    the derivatives with respect to the parameters are added.
    """

    @make_intrinsic
    def run(
        typing: Any, adjoint: Any, params: Any, work: Any, both: Any, by_params: Any, h: Any
    ) -> Any:
        check_contiguous(params, work, both, by_params)
        types = numba_core.types
        cgutils = numba_core.cgutils

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            adjoint, params, work, both, by_params, h = arguments
            array_types = signature.args
            rows = VectorRows(context, builder, array_types[2], work, WIDTH)
            numbers = context.make_array(array_types[1])(context, builder, params).data
            slopes = context.make_array(array_types[3])(context, builder, both)
            sums = context.make_array(array_types[4])(context, builder, by_params)
            p = builder.extract_value(sums.shape, 0)
            n = builder.sub(builder.extract_value(slopes.shape, 0), p)
            by_parameters = builder.gep(slopes.data, [n])
            for step in steps:
                if isinstance(step, Sum):
                    _emit_sum(builder, rows, step, rows.splat(h))
                    continue
                pointers = [rows.at(step.at), numbers, rows.at(step.covector), slopes.data]
                emit_call(builder, adjoint, pointers)
                out = rows.at(step.out)
                with cgutils.for_range(builder, n) as loop:
                    value = builder.load(builder.gep(slopes.data, [loop.index]))
                    builder.store(value, builder.gep(out, [loop.index]))
                with cgutils.for_range(builder, p) as loop:
                    total = builder.gep(sums.data, [loop.index])
                    value = builder.load(builder.gep(by_parameters, [loop.index]))
                    builder.store(builder.fadd(builder.load(total), value), total)
            return context.get_dummy_value()

        return types.void(types.int64, params, work, both, by_params, types.float64), generate

    return run


def _emit_sum(
    builder: Any, rows: VectorRows, step: Sum, scale: Any, flags: tuple[str, ...] = ()
) -> None:
    """Emit the instructions of a linear combination; `scale` is h as a vector."""
    cgutils = numba_core.cgutils
    stride, width = rows.stride, rows.vector.count
    with cgutils.for_range(builder, builder.udiv(stride, stride.type(width))) as loop:
        index = builder.mul(loop.index, stride.type(width))
        terms = [
            builder.fmul(
                ir.Constant(rows.vector, [weight] * width), rows.load(row, index), flags=flags
            )
            for row, weight in step.terms
        ]
        total = builder.fmul(scale, add_pairwise(builder, terms, flags), flags=flags)
        if step.base is not None:
            total = builder.fadd(rows.load(step.base, index), total, flags=flags)
        rows.store(total, step.out, index)
