"""Vectors and masks in compiled code: one number, or one truth value, per SIMD lane.

Expressions such as `a + b`, `a <= b`, `sqrt(a)` and `choose` are computed in all lanes at once. The
result in a lane depends on the operands in that lane only. A row stores the value of entry i in
lane j as number i·width + j. Kernels that evaluate several states at once use the same layout.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Any

from llvmlite import ir

from ..stepping.compiling import make_intrinsic, numba_core
from ..stepping.vector_rows import VectorRows, splat

_DOUBLE, _INT32 = ir.DoubleType(), ir.IntType(32)


def _vector_types() -> Any:
    """Import the module of numba's types; numba must know the operators before it compiles."""
    from . import vector_types

    return vector_types


def vector_type(width: int) -> Any:
    """Return numba's type of vectors with a number of lanes."""
    return _vector_types().Vector(width)


_in_lanes: Callable[..., Any] = partial(make_intrinsic, prepare=_vector_types)


# --- functions -----------------------------------------------------------------------------


@_in_lanes
def choose(typing: Any, mask: Any, yes: Any, no: Any) -> Any:
    """Return `yes` in the lanes where the mask is true, else `no`; both are numbers or vectors."""
    number, vector = numba_core.types.float64, vector_type(mask.width)
    width = mask.width
    branch_types = [number if branch_type == number else vector for branch_type in (yes, no)]

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        branches = [
            value if branch_type == vector else splat(builder, value, width)
            for branch_type, value in zip(sig.args[1:], args[1:], strict=True)
        ]
        return builder.select(args[0], *branches)

    return vector(mask, *branch_types), generate


@_in_lanes
def bits(typing: Any, mask: Any) -> Any:
    """Return the mask as an integer with lane 0 in its lowest bit."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        packed = builder.bitcast(args[0], ir.IntType(mask.width))
        return builder.zext(packed, ir.IntType(64))

    return numba_core.types.int64(mask), generate


@_in_lanes
def power(typing: Any, base: Any, exponent: Any) -> Any:
    """Return base to the power `exponent`, for each lane."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        callee = builder.module.declare_intrinsic("llvm.pow", [_DOUBLE])
        result = ir.Constant(args[0].type, ir.Undefined)
        for lane in range(base.width):
            position = _INT32(lane)
            value = builder.call(callee, [builder.extract_element(args[0], position), args[1]])
            result = builder.insert_element(result, value, position)
        return result

    return base(base, numba_core.types.float64), generate


@_in_lanes
def fetch_and_add(typing: Any, counter: Any, count: Any) -> Any:
    """Add `count` atomically to the int64 in `counter`, (1,), and return the previous value."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        array = context.make_array(sig.args[0])(context, builder, args[0])
        return builder.atomic_rmw("add", array.data, args[1], "monotonic")

    types = numba_core.types
    return types.int64(counter, types.int64), generate


@cache
def functions_of_width(width: int) -> dict[str, Any]:
    """Return the functions of step_formulas.py that depend on the number of lanes.

    They are same(number), get(rows, row, i) and put(rows, row, i, vector), for rows (R, n width).
    """

    @_in_lanes
    def same(typing: Any, number: Any) -> Any:
        def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            return splat(builder, args[0], width)

        return vector_type(width)(numba_core.types.float64), generate

    @_in_lanes
    def get(typing: Any, rows: Any, row: Any, i: Any) -> Any:
        def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            work = VectorRows(context, builder, sig.args[0], args[0], width)
            return work.load(args[1], builder.mul(args[2], args[2].type(width)))

        types = numba_core.types
        return vector_type(width)(rows, types.int64, types.int64), generate

    @_in_lanes
    def put(typing: Any, rows: Any, row: Any, i: Any, value: Any) -> Any:
        def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            work = VectorRows(context, builder, sig.args[0], args[0], width)
            work.store(args[3], args[1], builder.mul(args[2], args[2].type(width)))
            return context.get_dummy_value()

        types = numba_core.types
        return types.void(rows, types.int64, types.int64, vector_type(width)), generate

    return {"same": same, "get": get, "put": put, "choose": choose, "power": power}
