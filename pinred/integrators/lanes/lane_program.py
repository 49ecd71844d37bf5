"""Sums of rows of lanes, each lane with a step of its own, and calls of a kernel between them.

What explicit/row_sums does to the rows of one run, to those of as many as there are lanes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types

from ...common.arrays import Array
from ..explicit.row_sums import Rate, Sum
from ..stepping.compiling import make_intrinsic
from ..stepping.kernel_call import check_contiguous, emit_call
from .vectors import Vector

_FUSED = ("contract",)


def lane_program(
    steps: Sequence[Sum | Rate], width: int
) -> Callable[[int, Array, Array, Any], int]:
    """Return run(address, params, work, h), which does all steps and returns how many are calls.

    params, work: rows of lanes.  h: a vector.
    """
    calls, vector = sum(isinstance(step, Rate) for step in steps), Vector(width)

    @make_intrinsic
    def run(typing: Any, address: Any, params: Any, work: Any, h: Any) -> Any:  # noqa: ARG001
        check_contiguous(params, work)

        def generate(context: Any, builder: Any, sig: Any, arguments: Any) -> Any:
            address, params, work, h = arguments
            rows = _Rows(context, builder, sig.args[2], work, width)
            numbers = context.make_array(sig.args[1])(context, builder, params).data
            for step in steps:
                if isinstance(step, Rate):
                    emit_call(builder, address, [rows.at(step.at), numbers, rows.at(step.out)])
                else:
                    rows.add(step, h)
            return ir.Constant(ir.IntType(64), calls)

        return types.int64(types.int64, params, work, vector), generate

    return run


class _Rows:
    """The rows of lanes of a work array, as instructions see them."""

    def __init__(self, context: Any, builder: Any, kind: Any, work: Any, width: int) -> None:
        array = context.make_array(kind)(context, builder, work)
        self._data, self._builder, self._width = array.data, builder, width
        self._stride = builder.extract_value(array.shape, 1)
        self._vector = ir.VectorType(ir.DoubleType(), width)

    def at(self, row: int, offset: Any = None) -> Any:
        """Return the place of a number in a row, of the first one without an offset."""
        index = self._builder.mul(self._stride, self._stride.type(row))
        if offset is not None:
            index = self._builder.add(index, offset)
        return self._builder.gep(self._data, [index])

    def add(self, step: Sum, h: Any) -> None:
        """Write the instructions of a sum."""
        builder, width, stride = self._builder, self._width, self._stride
        with cgutils.for_range(builder, builder.udiv(stride, stride.type(width))) as loop:
            offset = builder.mul(loop.index, stride.type(width))

            def place(row: int) -> Any:
                return builder.bitcast(self.at(row, offset), self._vector.as_pointer())

            def load(row: int) -> Any:
                return builder.load(place(row), align=8)

            def scaled(row: int, weight: float) -> Any:
                each = ir.Constant(self._vector, [weight] * width)
                return builder.fmul(each, load(row), flags=_FUSED)

            parts = [scaled(*term) for term in step.terms]
            while len(parts) > 1:
                pairs = [
                    builder.fadd(*parts[i : i + 2], flags=_FUSED)
                    for i in range(0, len(parts) - 1, 2)
                ]
                parts = pairs + parts[2 * len(pairs) :]
            total = builder.fmul(h, parts[0], flags=_FUSED)
            if step.base is not None:
                total = builder.fadd(load(step.base), total, flags=_FUSED)
            builder.store(total, place(step.out), align=8)
