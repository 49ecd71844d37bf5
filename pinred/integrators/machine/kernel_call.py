"""What the steppers are made of: the call of a kernel by its address, and sums of rows.

A kernel is machine code `void f(const double *y, const double *params, double *dydt)`.
Its address is a number to the steppers, so that they are compiled once and not once more
for every kernel.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeVar

import numba
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

SOURCES = sha256(
    b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.parent.rglob("*.py")))
).hexdigest()
SEEDS = 8  # directions that a tangent kernel takes at once
LANES = 4  # rows are padded with zeros to a multiple of this
_VECTOR = ir.VectorType(ir.DoubleType(), LANES)
_Function = TypeVar("_Function", bound=Callable[..., Any])


def compiled(function: _Function) -> _Function:
    """Compile at the first call, keep the machine code on disk, run without the GIL.

    No fast-math: numbers do not depend on where a function is inlined.
    """
    out: Any = numba.njit(cache=True, nogil=True, error_model="numpy")(function)
    # numba takes machine code from disk as long as the file of the function is the same,
    # though it holds what other files have said.  Here it is as old as all of them.
    out._cache._cache_file._source_stamp = SOURCES
    typed: _Function = out
    return typed


def make_intrinsic(generator: Callable[..., Any]) -> Callable[..., Any]:
    """Return the function for compiled code whose instructions `generator` gives."""
    out: Callable[..., Any] = intrinsic(generator)
    return out


@make_intrinsic
def call(typing: Any, address: Any, y: Any, params: Any, dydt: Any) -> Any:  # noqa: ARG001
    """Let the kernel at `address` (int64) fill dydt with the rates at y.

    y (n,), params (p,) and dydt (n,) are contiguous arrays of float64.
    """
    return _calling(y, params, dydt)


@make_intrinsic
def call_tangent(  # type: ignore[no-untyped-def]
    typing: Any,  # noqa: ARG001
    address: Any,  # noqa: ARG001
    y: Any,
    params: Any,
    directions: Any,
    out: Any,
):
    """Let the tangent kernel at `address` (int64) fill `out` with the derivatives of ẏ.

    directions, out: SEEDS values an entry, one after another: out = ∂ẏ/∂y directions.
    """
    return _calling(y, params, directions, out)


def _calling(*arrays: Any) -> Any:
    """Return signature and instructions of a call with the data of arrays."""
    for array in arrays:
        if not (isinstance(array, types.Array) and array.layout == "C"):
            raise TypeError("a kernel takes contiguous arrays")
        if array.dtype != types.float64:
            raise TypeError("a kernel takes arrays of float64")

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointers = [
            context.make_array(kind)(context, builder, value).data
            for kind, value in zip(signature.args[1:], arguments[1:], strict=True)
        ]
        kernel = ir.FunctionType(ir.VoidType(), [pointer.type for pointer in pointers])
        builder.call(builder.inttoptr(arguments[0], kernel.as_pointer()), pointers)
        return context.get_dummy_value()

    return types.void(types.int64, *arrays), generate


def combination(out: int, base: int | None, weights: Sequence[float]) -> Callable[..., None]:
    """Return combine(work, h): work[out] = work[base] + h Σ_j weights[j] work[j].

    work is (rows, stride) with stride a multiple of LANES.  The loop is written with vector
    instructions, without the zeros among the weights and with the sum as a balanced tree.
    Without a base the sum begins at zero.
    """
    terms = [(row, float(weight)) for row, weight in enumerate(weights) if weight != 0.0]

    @make_intrinsic
    def combine(typing: Any, work: Any, h: Any) -> Any:  # noqa: ARG001
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            array = context.make_array(signature.args[0])(context, builder, arguments[0])
            stride = builder.extract_value(array.shape, 1)
            scale = _splat(builder, arguments[1])
            with cgutils.for_range(builder, builder.udiv(stride, stride.type(LANES))) as loop:
                offset = builder.mul(loop.index, stride.type(LANES))

                def place(row: int) -> Any:
                    index = builder.add(builder.mul(stride, stride.type(row)), offset)
                    return builder.bitcast(builder.gep(array.data, [index]), _VECTOR.as_pointer())

                def load(row: int) -> Any:
                    return builder.load(place(row), align=8)

                parts = [builder.fmul(_constant(weight), load(row)) for row, weight in terms]
                while len(parts) > 1:
                    pairs = [builder.fadd(*parts[i : i + 2]) for i in range(0, len(parts) - 1, 2)]
                    parts = pairs + parts[2 * len(pairs) :]
                total = builder.fmul(scale, parts[0])
                if base is not None:
                    total = builder.fadd(load(base), total)
                builder.store(total, place(out), align=8)
            return context.get_dummy_value()

        return types.void(work, types.float64), generate

    return combine


def _constant(value: float) -> Any:
    return ir.Constant(_VECTOR, [value] * LANES)


def _splat(builder: Any, value: Any) -> Any:
    vector = ir.Constant(_VECTOR, ir.Undefined)
    for lane in range(LANES):
        vector = builder.insert_element(vector, value, ir.IntType(32)(lane))
    return vector
