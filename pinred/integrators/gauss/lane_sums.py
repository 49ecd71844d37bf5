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

_DOUBLE = ir.DoubleType()
_FAST = ("contract",)


class _Rows:
    """Loads and stores of vectors in the rows of a work array."""

    def __init__(self, context: Any, builder: Any, kind: Any, work: Any, lanes: int) -> None:
        array = context.make_array(kind)(context, builder, work)
        self._data, self._builder, self._lanes = array.data, builder, lanes
        self._stride = builder.extract_value(array.shape, 1)
        self.vector = ir.VectorType(_DOUBLE, lanes)

    def at(self, row: Any, index: Any) -> Any:
        """Return the place of an entry of a row."""
        offset = self._builder.add(self._builder.mul(self._stride, row), index)
        return self._builder.gep(self._data, [offset])

    def number(self, row: Any, index: Any) -> Any:
        """Return one number, in all lanes."""
        return self.splat(self._builder.load(self.at(row, index), align=8))

    def splat(self, value: Any) -> Any:
        """Return a number in all lanes."""
        one = self._builder.insert_element(
            ir.Constant(self.vector, ir.Undefined), value, ir.IntType(32)(0)
        )
        zeros = ir.Constant(ir.VectorType(ir.IntType(32), self._lanes), [0] * self._lanes)
        return self._builder.shuffle_vector(one, ir.Constant(self.vector, ir.Undefined), zeros)

    def place(self, row: Any, index: Any) -> Any:
        """Return the place of a vector that begins at an entry of a row."""
        return self._builder.bitcast(self.at(row, index), self.vector.as_pointer())

    def load(self, row: Any, index: Any) -> Any:
        """Return a vector that begins at an entry of a row."""
        return self._builder.load(self.place(row, index), align=8)

    def store(self, value: Any, row: Any, index: Any) -> None:
        """Store a vector from an entry of a row on."""
        self._builder.store(value, self.place(row, index), align=8)


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
            rows = _Rows(context, builder, signature.args[0], arguments[0], lanes)
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
                while len(parts) > 1:
                    parts = [
                        builder.fadd(a, b, flags=_FAST)
                        for a, b in zip(parts[::2], parts[1::2], strict=True)
                    ]
                rows.store(builder.fadd(start, parts[0], flags=_FAST), out, first)
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
            rows = _Rows(context, builder, signature.args[0], arguments[0], lanes)
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
            while len(parts) > 1:
                parts = [builder.fadd(a, b) for a, b in zip(parts[::2], parts[1::2], strict=True)]
            return parts[0]

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
