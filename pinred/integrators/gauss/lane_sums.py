"""Vector instructions for steppers whose stages are lanes: one instruction does all of them.

A row over stages holds lane j of entry i at i lanes + j, as the kernels take it that evaluate
all stages at once.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types

from ..stepping.compiling import make_intrinsic
from ..stepping.vector_rows import VectorRows, add_pairwise

_FAST = ("contract",)


def product(lanes: int) -> Callable[..., None]:
    """Return multiply(work, out, base, table, row, n): out = base + table · row for n entries.

    out, row: over stages.  base: an entry each, or nothing if −1.  table: (lanes, lanes), the
    column of each lane after another.
    """

    @make_intrinsic
    def multiply(  # type: ignore[no-untyped-def]
        typing: Any,
        work: Any,
        out: Any,
        base: Any,
        table: Any,
        row: Any,
        n: Any,
    ):
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            rows = VectorRows(context, builder, signature.args[0], arguments[0], lanes)
            out, base, table, row, n = arguments[1:]
            integer = n.type
            columns = [rows.load(table, integer(lanes * j)) for j in range(lanes)]
            with_base = builder.icmp_signed(">=", base, integer(0))
            with cgutils.for_range(builder, n) as loop:
                first = builder.mul(loop.index, integer(lanes))
                start = builder.select(
                    with_base,
                    rows.number(builder.select(with_base, base, integer(0)), loop.index),
                    ir.Constant(rows.vector, [0.0] * lanes),
                )
                parts = [
                    builder.fmul(
                        column,
                        rows.number(row, builder.add(first, integer(j))),
                        flags=_FAST,
                    )
                    for j, column in enumerate(columns)
                ]
                total = builder.fadd(start, add_pairwise(builder, parts, _FAST), flags=_FAST)
                rows.store(total, out, first)
            return context.get_dummy_value()

        whole = types.int64
        return types.void(work, whole, whole, whole, whole, whole), generate

    return multiply


def refreshment(lanes: int) -> Callable[..., float]:
    """Return refresh(work, row, rate, last, best, scale, weights, n, h).

    It puts h weights · rate into `row`, over stages, and returns Σ (change / scale)², the
    entries of `scale` being inverse.  last: the changes of the turn before.  best: the least
    that two turns have had so far; its entry after all stages says for how many numbers that
    is these two.  One turn says little, as positions and momenta may change by turns.
    """

    @make_intrinsic
    def refresh(  # type: ignore[no-untyped-def]
        typing: Any, work: Any, row: Any, rate: Any, last: Any, best: Any, scale: Any,
        weights: Any, n: Any, h: Any,
    ):  # fmt: skip
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            rows = VectorRows(context, builder, signature.args[0], arguments[0], lanes)
            row, rate, last, best, scale, weights, n, h = arguments[1:]
            integer, T = n.type, rows.vector
            zero, one = ir.Constant(T, [0.0] * lanes), ir.Constant(T, [1.0] * lanes)
            factor = builder.fmul(rows.splat(h), rows.load(weights, integer(0)))
            size, less = (_variable(builder, zero) for _ in range(2))
            fabs = _absolute(builder, T, lanes)
            with cgutils.for_range(builder, n) as loop:
                first = builder.mul(loop.index, integer(lanes))
                new = builder.fmul(factor, rows.load(rate, first))
                change = builder.call(fabs, [builder.fsub(new, rows.load(row, first))])
                rows.store(new, row, first)
                before, least = rows.load(last, first), rows.load(best, first)
                rows.store(change, last, first)
                more = builder.select(builder.fcmp_ordered(">", change, before), change, before)
                improved = builder.and_(
                    builder.fcmp_ordered("<", more, least), builder.fcmp_ordered(">", more, zero)
                )
                rows.store(builder.select(improved, more, least), best, first)
                counted = builder.fadd(builder.load(less), builder.select(improved, one, zero))
                builder.store(counted, less)
                relative = builder.fmul(change, rows.number(scale, loop.index))
                total = builder.fadd(builder.load(size), builder.fmul(relative, relative))
                builder.store(total, size)
            rows.store(builder.load(less), best, builder.mul(n, integer(lanes)))
            summed = builder.load(size)
            parts = [builder.extract_element(summed, ir.IntType(32)(j)) for j in range(lanes)]
            return add_pairwise(builder, parts)

        whole = types.int64
        kinds = (work, *(whole,) * 7, types.float64)
        return types.float64(*kinds), generate

    return refresh


def _absolute(builder: Any, T: Any, lanes: int) -> Any:
    """Return the function of the absolute values of a vector."""
    make: Callable[..., Any] = cgutils.get_or_insert_function
    return make(builder.module, ir.FunctionType(T, [T]), f"llvm.fabs.v{lanes}f64")


def _variable(builder: Any, value: Any) -> Any:
    """Return the place of a variable with a first value."""
    make: Callable[..., Any] = cgutils.alloca_once_value
    return make(builder, value)
