"""Sums of rows in vector instructions, and calls of a kernel between them.

What an explicit method does to the rows `work` (rows, stride) is a list of `Sum` and `Rate`; it
is written out without loops over stages, and without the zeros of the tableau.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from llvmlite import ir
from numba.core import cgutils, types

from ...common.arrays import Array
from ..stepping.compiling import make_intrinsic
from ..stepping.kernel_call import check_contiguous, emit_call
from ..stepping.state_rows import WIDTH

_VECTOR = ir.VectorType(ir.DoubleType(), WIDTH)

Terms: TypeAlias = Sequence[tuple[int, float]]  # row and weight


@dataclass(frozen=True)
class Sum:
    """Row `out` = row `base` + h Σ weight · row, as a balanced tree; without a base from zero."""

    out: int
    base: int | None
    terms: Terms


@dataclass(frozen=True)
class Rate:
    """Row `out` = the kernel's rates at the state in row `at`."""

    at: int
    out: int


@dataclass(frozen=True)
class Slopes:
    """Row `out` = slopes of row `covector` · the rates at the state in row `at`, by that state.

    Those by parameters are added up.
    """

    at: int
    covector: int
    out: int


def row_sum(out: int, base: int | None, terms: Terms) -> Callable[[Array, float], None]:
    """Return combine(work, h), which makes one sum."""

    @make_intrinsic
    def combine(typing: Any, work: Any, h: Any) -> Any:  # noqa: ARG001
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            rows = _Rows(context, builder, signature.args[0], arguments[0])
            rows.add(Sum(out, base, terms), arguments[1])
            return context.get_dummy_value()

        return types.void(work, types.float64), generate

    return combine


def row_program(steps: Sequence[Sum | Rate]) -> Callable[[int, Array, Array, float], int]:
    """Return run(address, params, work, h), which does all steps and returns how many are calls."""
    calls = sum(isinstance(step, Rate) for step in steps)

    @make_intrinsic
    def run(typing: Any, address: Any, params: Any, work: Any, h: Any) -> Any:  # noqa: ARG001
        check_contiguous(params, work)

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            address, params, work, h = arguments
            rows = _Rows(context, builder, signature.args[2], work)
            numbers = context.make_array(signature.args[1])(context, builder, params).data
            for step in steps:
                if isinstance(step, Rate):
                    emit_call(builder, address, [rows.at(step.at), numbers, rows.at(step.out)])
                else:
                    rows.add(step, h)
            return ir.Constant(ir.IntType(64), calls)

        return types.int64(types.int64, params, work, types.float64), generate

    return run


def slope_program(
    steps: Sequence[Sum | Slopes],
) -> Callable[[int, Array, Array, Array, Array, float], None]:
    """Return run(adjoint, params, work, both, by_params, h), which does all steps.

    both: (n + p,), which the adjoint fills.  by_params: (p,), to which slopes by them are added.
    """

    @make_intrinsic
    def run(  # type: ignore[no-untyped-def]
        typing: Any,  # noqa: ARG001
        adjoint: Any,  # noqa: ARG001
        params: Any,
        work: Any,
        both: Any,
        by_params: Any,
        h: Any,  # noqa: ARG001
    ):
        check_contiguous(params, work, both, by_params)

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            adjoint, params, work, both, by_params, h = arguments
            kinds = signature.args
            rows = _Rows(context, builder, kinds[2], work)
            numbers = context.make_array(kinds[1])(context, builder, params).data
            slopes = context.make_array(kinds[3])(context, builder, both)
            sums = context.make_array(kinds[4])(context, builder, by_params)
            p = builder.extract_value(sums.shape, 0)
            n = builder.sub(builder.extract_value(slopes.shape, 0), p)
            by_parameters = builder.gep(slopes.data, [n])
            for step in steps:
                if isinstance(step, Sum):
                    rows.add(step, h)
                    continue
                places = [rows.at(step.at), numbers, rows.at(step.covector), slopes.data]
                emit_call(builder, adjoint, places)
                out = rows.at(step.out)
                with cgutils.for_range(builder, n) as loop:
                    value = builder.load(builder.gep(slopes.data, [loop.index]))
                    builder.store(value, builder.gep(out, [loop.index]))
                with cgutils.for_range(builder, p) as loop:
                    place = builder.gep(sums.data, [loop.index])
                    value = builder.load(builder.gep(by_parameters, [loop.index]))
                    builder.store(builder.fadd(builder.load(place), value), place)
            return context.get_dummy_value()

        return types.void(types.int64, params, work, both, by_params, types.float64), generate

    return run


class _Rows:
    """The rows of a work array, as instructions see them."""

    def __init__(self, context: Any, builder: Any, kind: Any, work: Any) -> None:
        array = context.make_array(kind)(context, builder, work)
        self._data, self._builder = array.data, builder
        self._stride = builder.extract_value(array.shape, 1)

    def at(self, row: int, offset: Any = None) -> Any:
        """Return the place of a number in a row, of the first one without an offset."""
        index = self._builder.mul(self._stride, self._stride.type(row))
        if offset is not None:
            index = self._builder.add(index, offset)
        return self._builder.gep(self._data, [index])

    def add(self, step: Sum, h: Any) -> None:
        """Write the instructions of a sum."""
        builder, stride = self._builder, self._stride
        scale = _splat(builder, h)
        with cgutils.for_range(builder, builder.udiv(stride, stride.type(WIDTH))) as loop:
            offset = builder.mul(loop.index, stride.type(WIDTH))

            def place(row: int) -> Any:
                return builder.bitcast(self.at(row, offset), _VECTOR.as_pointer())

            def load(row: int) -> Any:
                return builder.load(place(row), align=8)

            parts = [builder.fmul(_constant(weight), load(row)) for row, weight in step.terms]
            while len(parts) > 1:
                pairs = [builder.fadd(*parts[i : i + 2]) for i in range(0, len(parts) - 1, 2)]
                parts = pairs + parts[2 * len(pairs) :]
            total = builder.fmul(scale, parts[0])
            if step.base is not None:
                total = builder.fadd(load(step.base), total)
            builder.store(total, place(step.out), align=8)


def _constant(value: float) -> Any:
    return ir.Constant(_VECTOR, [value] * WIDTH)


def _splat(builder: Any, value: Any) -> Any:
    vector = ir.Constant(_VECTOR, ir.Undefined)
    for lane in range(WIDTH):
        vector = builder.insert_element(vector, value, ir.IntType(32)(lane))
    return vector
