"""Intrinsics: LLVM instructions that compiled functions need and Python cannot express.

They call kernels, and they process the rows of a work array in SIMD vectors. A kernel is
machine code `void f(const double *y, const double *params, double *dydt)`. Steppers take its
address as a number, so each stepper is compiled once for all kernels.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir

from ...common.arrays import Array
from .compiling import compiled, make_intrinsic, numba_core

SEEDS = 8  # number of tangent directions per call of a tangent kernel


@make_intrinsic
def call(typing: Any, address: Any, y: Any, params: Any, dydt: Any) -> Any:
    """Fill dydt with the rates at y, computed by the kernel at `address`; arrays are float64."""
    return _calling(y, params, dydt)


@make_intrinsic
def call_tangent(typing: Any, address: Any, y: Any, params: Any, directions: Any, out: Any) -> Any:
    """Write ∂ẏ/∂y · directions to `out`, with SEEDS consecutive values for each entry."""
    return _calling(y, params, directions, out)


@make_intrinsic
def call_slopes(
    typing: Any, address: Any, y: Any, params: Any, along_y: Any, along_params: Any, out: Any
) -> Any:
    """Write the derivatives of ẏ along directions of (y, params) to `out`, SEEDS per entry."""
    return _calling(y, params, along_y, along_params, out)


@make_intrinsic
def call_adjoint(typing: Any, address: Any, y: Any, params: Any, covector: Any, out: Any) -> Any:
    """Write the derivatives of covector · ẏ with respect to y, then the parameters, to `out`."""
    return _calling(y, params, covector, out)


@make_intrinsic
def call_closing(
    typing: Any, address: Any, y: Any, params: Any, end: Any, pull: Any, out: Any
) -> Any:
    """Write the gap of closed loops at `end`, and the pull that closes it, to `out`."""
    return _calling(y, params, end, pull, out)


def _calling(*arrays: Any) -> Any:
    """Return signature and code generator of a kernel call with the data pointers of arrays."""
    check_contiguous(*arrays)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointers = [
            context.make_array(array_type)(context, builder, value).data
            for array_type, value in zip(signature.args[1:], arguments[1:], strict=True)
        ]
        emit_call(builder, arguments[0], pointers)
        return context.get_dummy_value()

    types = numba_core.types
    return types.void(types.int64, *arrays), generate


def check_contiguous(*arrays: Any) -> None:
    """Check that numba's array types are contiguous arrays of float64, which kernels require."""
    types = numba_core.types
    for array in arrays:
        if not (isinstance(array, types.Array) and array.layout == "C"):
            raise TypeError("kernel arguments must be contiguous arrays")
        if array.dtype != types.float64:
            raise TypeError("kernel arguments must be arrays of float64")


def emit_call(builder: Any, address: Any, pointers: list[Any]) -> None:
    """Emit the instructions that call a kernel.

    Args:
        builder: LLVM builder.
        address: Address of the kernel, an LLVM int64.
        pointers: Pointers to the data of the arguments.
    """
    signature = ir.FunctionType(ir.VoidType(), [pointer.type for pointer in pointers])
    builder.call(builder.inttoptr(address, signature.as_pointer()), pointers)


@compiled
def to_lanes(along: Array, out: Array) -> None:
    """Arrange directions (n, N) in the layout of tangent kernels: `out`, (B, n SEEDS)."""
    for k in range(along.shape[0]):
        for j in range(along.shape[1]):
            out[j // SEEDS, k * SEEDS + j % SEEDS] = along[k, j]


@compiled
def from_lanes(lanes: Array, out: Array) -> None:
    """Inverse of `to_lanes`: write the directions to `out`, (n, N)."""
    for k in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[k, j] = lanes[j // SEEDS, k * SEEDS + j % SEEDS]


FUSED = ("contract",)  # LLVM flag that lets a multiplication and an addition become one instruction
_INT32 = ir.IntType(32)


def splat(builder: Any, value: Any, width: int) -> Any:
    """Return a vector of `width` lanes that all contain `value`."""
    vector = ir.VectorType(value.type, width)
    undefined = ir.Constant(vector, ir.Undefined)
    first = builder.insert_element(undefined, value, _INT32(0))
    zeros = ir.Constant(ir.VectorType(_INT32, width), [0] * width)
    return builder.shuffle_vector(first, undefined, zeros)


def add_pairwise(builder: Any, terms: list[Any], flags: tuple[str, ...] = ()) -> Any:
    """Return the sum of terms, added as a balanced tree."""
    while len(terms) > 1:
        pairs = [builder.fadd(*terms[i : i + 2], flags=flags) for i in range(0, len(terms) - 1, 2)]
        terms = pairs + terms[2 * len(pairs) :]
    return terms[0]


class VectorRows:
    """The rows of a work array (rows, stride) as LLVM instructions address them.

    Attributes:
        stride: LLVM value: distance between the starts of successive rows, in floats.
        vector: LLVM type of `width` float64 numbers.
    """

    def __init__(self, context: Any, builder: Any, array_type: Any, work: Any, width: int) -> None:
        """Store numba's context and builder, and the type and value of the work array."""
        array = context.make_array(array_type)(context, builder, work)
        self._data, self._builder, self._width = array.data, builder, width
        self.stride = builder.extract_value(array.shape, 1)
        self.vector = ir.VectorType(ir.DoubleType(), width)

    def at(self, row: Any, index: Any = None) -> Any:
        """Return a pointer to an entry of a row; without an index, to the first entry.

        Args:
            row: Row, a Python integer or an LLVM value.
            index: Index within the row, an LLVM value.
        Returns:
            The pointer.
        """
        start = self.stride.type(row) if isinstance(row, int) else row
        position = self._builder.mul(self.stride, start)
        if index is not None:
            position = self._builder.add(position, index)
        return self._builder.gep(self._data, [position])

    def splat(self, value: Any) -> Any:
        """Return a vector that contains the same number in all lanes."""
        return splat(self._builder, value, self._width)

    def number(self, row: Any, index: Any) -> Any:
        """Return a vector that contains one entry of a row in all lanes."""
        return self.splat(self._builder.load(self.at(row, index), align=8))

    def load(self, row: Any, index: Any) -> Any:
        """Return the vector that starts at an index of a row."""
        return self._builder.load(self._vector_at(row, index), align=8)

    def store(self, value: Any, row: Any, index: Any) -> None:
        """Store a vector at an index of a row."""
        self._builder.store(value, self._vector_at(row, index), align=8)

    def _vector_at(self, row: Any, index: Any) -> Any:
        return self._builder.bitcast(self.at(row, index), self.vector.as_pointer())
