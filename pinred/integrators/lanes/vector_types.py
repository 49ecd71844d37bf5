"""numba's types for vectors and masks, and the operators on them.

numba knows the operators once this module is imported.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from functools import partial
from math import sqrt
from typing import Any, ClassVar

from llvmlite import ir
from numba import extending
from numba.core import cgutils, types
from numba.core.typing import templates

from ..stepping.intrinsics import FUSED, splat

# numba has no type hints for these functions.
signature: Any = templates.signature
infer_global: Any = templates.infer_global
lower_builtin: Any = extending.lower_builtin
register_model: Any = extending.register_model
insert_function: Any = cgutils.get_or_insert_function
new_model: Any = extending.models.PrimitiveModel.__init__


class _PerLane(types.Type):
    """Numba type with one entry per SIMD lane.

    Attributes:
        width: Number of lanes.
        entry: LLVM type of an entry.
    """

    entry: ClassVar[Any]

    def __init__(self, width: int) -> None:
        """Create the type for a number of lanes."""
        self.width = width
        super().__init__(name=f"pinred_{type(self).__name__.lower()}{width}")


class Vector(_PerLane):
    """Numba type with one float64 per SIMD lane."""

    entry = ir.DoubleType()


class Mask(_PerLane):
    """Numba type with one truth value per SIMD lane."""

    entry = ir.IntType(1)


@register_model(Vector)
@register_model(Mask)
class _LaneModel(extending.models.PrimitiveModel):
    def __init__(self, manager: Any, kind: _PerLane) -> None:
        new_model(self, manager, kind, ir.VectorType(kind.entry, kind.width))


# --- operators -----------------------------------------------------------------------------


def _in_lanes(builder: Any, operand_types: Any, values: Any) -> list[Any]:
    """Return the operands as vectors; numbers are copied to all lanes."""
    (width,) = {
        operand_type.width for operand_type in operand_types if isinstance(operand_type, Vector)
    }
    return [
        value if isinstance(operand_type, Vector) else splat(builder, value, width)
        for operand_type, value in zip(operand_types, values, strict=True)
    ]


def _operands(args: Any) -> int:
    """Return the number of lanes of two operands if one of them is a vector, else 0."""
    widths = {operand_type.width for operand_type in args if isinstance(operand_type, Vector)}
    all_numeric = all(
        isinstance(operand_type, Vector) or operand_type == types.float64 for operand_type in args
    )
    return widths.pop() if len(args) == 2 and all_numeric and len(widths) == 1 else 0


def _binary(function: Any, result: type, emit: Callable[[Any, Any, Any], Any]) -> None:
    """Register an operator on two vectors, or on a vector and a number.

    Args:
        function: The operator.
        result: Vector or Mask.
        emit: Function of the LLVM builder and two vectors that emits the instruction.
    """

    class Typed(templates.AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            width = _operands(args)
            return signature(result(width), *args) if width else None

    infer_global(function)(Typed)

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return emit(builder, *_in_lanes(builder, sig.args, args))

    for operand_types in ((Vector, Vector), (Vector, types.Float), (types.Float, Vector)):
        lower_builtin(function, *operand_types)(lowered)


def _arithmetic(builder: Any, x: Any, y: Any, name: str) -> Any:
    return getattr(builder, name)(x, y, flags=FUSED)


def _comparison(builder: Any, x: Any, y: Any, sign: str) -> Any:
    return builder.fcmp_ordered(sign, x, y)


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
    # Comparisons with NaN are false.
    _binary(_function, Mask, partial(_comparison, sign=_sign))


def _logical(function: Any, count: int, emit: Callable[..., Any]) -> None:
    """Register an operator on masks.

    Args:
        function: The operator.
        count: Number of operands.
        emit: Function of the LLVM builder and the masks that emits the instruction.
    """

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
    """Register a function of one vector as an LLVM intrinsic."""

    class Typed(templates.AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            fits = len(args) == 1 and isinstance(args[0], Vector)
            return signature(args[0], args[0]) if fits else None

    infer_global(function)(Typed)

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        vector_type = args[0].type
        full_name = f"{name}.v{vector_type.count}f64"
        callee = insert_function(
            builder.module, ir.FunctionType(vector_type, [vector_type]), full_name
        )
        return builder.call(callee, args)

    lower_builtin(function, Vector)(lowered)


_unary(sqrt, "llvm.sqrt")
_unary(abs, "llvm.fabs")
