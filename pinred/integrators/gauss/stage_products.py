"""Vector instructions on stage rows: a table times a row, and one fixed-point iteration."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir

from ...common.arrays import Array
from ..stepping.compiling import inlined, make_intrinsic, numba_core
from ..stepping.vector_rows import VectorRows, add_pairwise
from .tables import BEST, CHANGE, RATE, SCALE, B

_CONTRACT = ("contract",)


def product(lanes: int) -> Callable[..., None]:
    """Return the compiled function multiply(work, out, base, table, row, n).

    It computes row `out` = row `base` + table · row `row` for n entries. `out` and `row` are stage
    rows. `base` has one number per entry, or is −1 for zero. `table` is (lanes, lanes), stored by
    columns.
    """

    @make_intrinsic
    def multiply(  # type: ignore[no-untyped-def]
        typing: Any, work: Any, out: Any, base: Any, table: Any, row: Any, n: Any
    ):
        types = numba_core.types
        cgutils = numba_core.cgutils

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
                terms = [
                    builder.fmul(
                        column,
                        rows.number(row, builder.add(first, integer(j))),
                        flags=_CONTRACT,
                    )
                    for j, column in enumerate(columns)
                ]
                total = builder.fadd(
                    start, add_pairwise(builder, terms, _CONTRACT), flags=_CONTRACT
                )
                rows.store(total, out, first)
            return context.get_dummy_value()

        integer_type = types.int64
        return types.void(
            work, integer_type, integer_type, integer_type, integer_type, integer_type
        ), generate

    return multiply


def refreshment(lanes: int) -> Callable[..., float]:
    """Return refresh(work, row, rate, last, best, scale, weights, n, h), one fixed-point iteration.

    It sets the stage row `row` to h weights · rate and returns Σ (change · scale)². `last` contains
    the changes of the previous iteration. Positions and momenta may change alternately, so the
    larger of two successive changes is compared, and `best` contains its minimum so far. The vector
    after the stages of `best` counts the entries whose minimum has improved.
    """

    @make_intrinsic
    def refresh(  # type: ignore[no-untyped-def]
        typing: Any, work: Any, row: Any, rate: Any, last: Any, best: Any, scale: Any,
        weights: Any, n: Any, h: Any,
    ):  # fmt: skip
        types = numba_core.types
        cgutils = numba_core.cgutils

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            rows = VectorRows(context, builder, signature.args[0], arguments[0], lanes)
            row, rate, last, best, scale, weights, n, h = arguments[1:]
            integer, T = n.type, rows.vector
            zero, one = ir.Constant(T, [0.0] * lanes), ir.Constant(T, [1.0] * lanes)
            factor = builder.fmul(rows.splat(h), rows.load(weights, integer(0)))
            size, improvements = (_variable(builder, zero) for _ in range(2))
            fabs = _absolute(builder, T, lanes)
            with cgutils.for_range(builder, n) as loop:
                first = builder.mul(loop.index, integer(lanes))
                new = builder.fmul(factor, rows.load(rate, first))
                change = builder.call(fabs, [builder.fsub(new, rows.load(row, first))])
                rows.store(new, row, first)
                previous, smallest = rows.load(last, first), rows.load(best, first)
                rows.store(change, last, first)
                larger = builder.select(
                    builder.fcmp_ordered(">", change, previous), change, previous
                )
                improved = builder.and_(
                    builder.fcmp_ordered("<", larger, smallest),
                    builder.fcmp_ordered(">", larger, zero),
                )
                rows.store(builder.select(improved, larger, smallest), best, first)
                counted = builder.fadd(
                    builder.load(improvements), builder.select(improved, one, zero)
                )
                builder.store(counted, improvements)
                relative = builder.fmul(change, rows.number(scale, loop.index))
                total = builder.fadd(builder.load(size), builder.fmul(relative, relative))
                builder.store(total, size)
            rows.store(builder.load(improvements), best, builder.mul(n, integer(lanes)))
            summed = builder.load(size)
            sums = [builder.extract_element(summed, ir.IntType(32)(j)) for j in range(lanes)]
            return add_pairwise(builder, sums)

        integer_type = types.int64
        argument_types = (work, *(integer_type,) * 7, types.float64)
        return types.float64(*argument_types), generate

    return refresh


def _absolute(builder: Any, T: Any, lanes: int) -> Any:
    """Return LLVM's function for the absolute values of a vector."""
    cgutils = numba_core.cgutils
    get_function: Callable[..., Any] = cgutils.get_or_insert_function
    return get_function(builder.module, ir.FunctionType(T, [T]), f"llvm.fabs.v{lanes}f64")


def _variable(builder: Any, value: Any) -> Any:
    """Allocate a variable with an initial value; return its address."""
    cgutils = numba_core.cgutils
    return cgutils.alloca_once_value(builder, value)


_multiply4, _multiply8 = product(4), product(8)
_refresh4, _refresh8 = refreshment(4), refreshment(8)


@inlined
def multiply(work: Array, out: int, base: int, table: int, row: int, n: int, lanes: int) -> None:
    """Compute a table times a stage row, plus a row.

    Args:
        work: Work rows.
        out: Stage row of the result.
        base: Row to add, one number per entry, −1 for zero.
        table: Row of the table, stored by columns.
        row: Stage row to multiply.
        n: Number of entries of the state.
        lanes: Number of SIMD lanes.
    """
    if lanes == 4:
        _multiply4(work, out, base, table, row, n)
    else:
        _multiply8(work, out, base, table, row, n)


@inlined
def refresh(work: Array, row: int, n: int, lanes: int, h: float) -> float:
    """Set the stage increments in a row to h b RATE; return the weighted norm of their change.

    Args:
        work: Work rows.
        row: Row of the stage increments L.
        n: Number of entries of the state.
        lanes: Number of SIMD lanes.
        h: Length of the step [s].
    Returns:
        The norm, the square root of Σ (change · scale)².
    """
    if lanes == 4:
        total = _refresh4(work, row, RATE, CHANGE, BEST, SCALE, B, n, h)
    else:
        total = _refresh8(work, row, RATE, CHANGE, BEST, SCALE, B, n, h)
    return float(np.sqrt(total))
