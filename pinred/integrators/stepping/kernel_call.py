"""Calls of kernels by their address.

A kernel is machine code `void f(const double *y, const double *params, double *dydt)`. Steppers
take its address as a number, so each stepper is compiled once for all kernels.
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
