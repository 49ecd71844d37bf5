"""Vectors in compiled code: a number of each lane, and truth values of each, in one register.

What is written with them is written once for all lanes: `a + b`, `a <= b`, `sqrt(a)`, `choose`.
Every operation gives in a lane what that lane holds alone, so that lanes know nothing of each
other.  Rows hold lane j of entry i at i width + j, as kernels take it that evaluate many states.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from functools import cache, partial
from math import sqrt
from typing import Any

from llvmlite import ir
from numba import extending
from numba.core import cgutils, types
from numba.core.typing import templates

from ..stepping.compiling import make_intrinsic
from ..stepping.vector_rows import VectorRows, splat

# numba says nothing of the types of these.
signature: Any = templates.signature
infer_global: Any = templates.infer_global
lower_builtin: Any = extending.lower_builtin
register_model: Any = extending.register_model
insert_function: Any = cgutils.get_or_insert_function
new_model: Any = extending.models.PrimitiveModel.__init__

_DOUBLE, _BIT, _INT32 = ir.DoubleType(), ir.IntType(1), ir.IntType(32)


class Vector(types.Type):
    """A float64 in each lane, to numba."""

    def __init__(self, width: int) -> None:
        """Take the number of lanes."""
        self.width = width
        super().__init__(name=f"pinred_vector{width}")


class Mask(types.Type):
    """A truth value in each lane, to numba."""

    def __init__(self, width: int) -> None:
        """Take the number of lanes."""
        self.width = width
        super().__init__(name=f"pinred_mask{width}")


@register_model(Vector)
class _VectorModel(extending.models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Vector) -> None:
        new_model(self, manager, kind, ir.VectorType(_DOUBLE, kind.width))


@register_model(Mask)
class _MaskModel(extending.models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Mask) -> None:
        new_model(self, manager, kind, ir.VectorType(_BIT, kind.width))


# --- operators -----------------------------------------------------------------------------


def _in_lanes(builder: Any, kinds: Any, values: Any) -> list[Any]:
    """Return the vectors among values, and numbers in all lanes."""
    (width,) = {kind.width for kind in kinds if isinstance(kind, Vector)}
    return [
        value if isinstance(kind, Vector) else splat(builder, value, width)
        for kind, value in zip(kinds, values, strict=True)
    ]


def _operands(args: Any) -> int:
    """Return the width of two operands of which one is a vector, 0 for others."""
    widths = {kind.width for kind in args if isinstance(kind, Vector)}
    known = all(isinstance(kind, Vector) or kind == types.float64 for kind in args)
    return widths.pop() if len(args) == 2 and known and len(widths) == 1 else 0


def _binary(function: Any, result: type, emit: Callable[[Any, Any, Any], Any]) -> None:
    """Tell numba an operator on vectors, or on a vector and a number."""

    class Typed(templates.AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            width = _operands(args)
            return signature(result(width), *args) if width else None

    infer_global(function)(Typed)

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return emit(builder, *_in_lanes(builder, sig.args, args))

    for kinds in ((Vector, Vector), (Vector, types.Float), (types.Float, Vector)):
        lower_builtin(function, *kinds)(lowered)


def _arithmetic(builder: Any, x: Any, y: Any, name: str) -> Any:
    return getattr(builder, name)(x, y, flags=FUSED)


def _comparison(builder: Any, x: Any, y: Any, sign: str) -> Any:
    return builder.fcmp_ordered(sign, x, y)


FUSED = ("contract",)  # a multiplication and the addition of its product may be one instruction

for _function, _name in (
    (operator.add, "fadd"), (operator.sub, "fsub"), (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):  # fmt: skip
    _binary(
        _function,
        Vector,
        partial(_arithmetic, name=_name),
    )
for _function, _sign in (
    (operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">="),
    (operator.eq, "=="),
):  # fmt: skip
    # NaN compares as false.
    _binary(_function, Mask, partial(_comparison, sign=_sign))


def _logical(function: Any, count: int, emit: Callable[..., Any]) -> None:
    """Tell numba an operator on truth values."""

    class Typed(templates.AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            fits = len(args) == count and all(isinstance(a, Mask) for a in args)
            return signature(args[0], *args) if fits else None

    infer_global(function)(Typed)

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return emit(builder, *args)

    lower_builtin(function, *[Mask] * count)(lowered)


_logical(operator.and_, 2, lambda b, x, y: b.and_(x, y))
_logical(operator.or_, 2, lambda b, x, y: b.or_(x, y))
_logical(operator.invert, 1, lambda b, x: b.not_(x))


def _unary(function: Any, name: str) -> None:
    """Tell numba a function of one vector that LLVM has."""

    class Typed(templates.AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            fits = len(args) == 1 and isinstance(args[0], Vector)
            return signature(args[0], args[0]) if fits else None

    infer_global(function)(Typed)

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kind = args[0].type
        whole = f"{name}.v{kind.count}f64"
        called = insert_function(builder.module, ir.FunctionType(kind, [kind]), whole)
        return builder.call(called, args)

    lower_builtin(function, Vector)(lowered)


_unary(sqrt, "llvm.sqrt")
_unary(abs, "llvm.fabs")


# --- functions -----------------------------------------------------------------------------


@make_intrinsic
def choose(typing: Any, mask: Any, yes: Any, no: Any) -> Any:
    """Return `yes` in the lanes where the mask is true, `no` in the others; numbers or vectors."""
    number, width = types.float64, mask.width
    kinds = [types.float64 if kind == number else Vector(width) for kind in (yes, no)]

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        both = [
            value if isinstance(kind, Vector) else splat(builder, value, width)
            for kind, value in zip(sig.args[1:], args[1:], strict=True)
        ]
        return builder.select(args[0], *both)

    return Vector(width)(mask, *kinds), generate


@make_intrinsic
def bits(typing: Any, mask: Any) -> Any:
    """Return the truth values as a whole number, lane 0 in its lowest bit; 0 if none is true."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        packed = builder.bitcast(args[0], ir.IntType(mask.width))
        return builder.zext(packed, ir.IntType(64))

    return types.int64(mask), generate


@make_intrinsic
def power(typing: Any, base: Any, exponent: Any) -> Any:
    """Return a power of each lane, one after another."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        called = builder.module.declare_intrinsic("llvm.pow", [_DOUBLE])
        out = ir.Constant(args[0].type, ir.Undefined)
        for lane in range(base.width):
            at = _INT32(lane)
            value = builder.call(called, [builder.extract_element(args[0], at), args[1]])
            out = builder.insert_element(out, value, at)
        return out

    return base(base, types.float64), generate


@make_intrinsic
def fetch_and_add(typing: Any, counter: Any, count: Any) -> Any:
    """Add `count` to the number in counter (1,), int64, and return what it was.

    No two threads get the same.
    """

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        array = context.make_array(sig.args[0])(context, builder, args[0])
        return builder.atomic_rmw("add", array.data, args[1], "monotonic")

    return types.int64(counter, types.int64), generate


@cache
def functions_of_width(width: int) -> dict[str, Any]:
    """Return the functions that depend on how many lanes there are.

    same(number): it in all lanes.  get(rows, row, i), put(rows, row, i, vector): entry i of a row
    of rows (R, n width), contiguous.
    """
    vector = Vector(width)

    @make_intrinsic
    def same(typing: Any, number: Any) -> Any:
        def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            return splat(builder, args[0], width)

        return vector(types.float64), generate

    @make_intrinsic
    def get(typing: Any, rows: Any, row: Any, i: Any) -> Any:
        def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            work = VectorRows(context, builder, sig.args[0], args[0], width)
            return work.load(args[1], builder.mul(args[2], args[2].type(width)))

        return vector(rows, types.int64, types.int64), generate

    @make_intrinsic
    def put(typing: Any, rows: Any, row: Any, i: Any, value: Any) -> Any:
        def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            work = VectorRows(context, builder, sig.args[0], args[0], width)
            work.store(args[3], args[1], builder.mul(args[2], args[2].type(width)))
            return context.get_dummy_value()

        return types.void(rows, types.int64, types.int64, vector), generate

    return {"same": same, "get": get, "put": put, "choose": choose, "power": power}
