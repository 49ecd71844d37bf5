"""The Jacobian of a kernel's vector field with respect to the reduced state."""

from __future__ import annotations

from functools import partial

import numpy as np

from ..common.arrays import Array
from ..common.machine_code import NativeCode
from .derived_code import derived_code, jacobian_by_columns, tangent_of, validate_jacobian
from .differentiable import call_value
from .jacobian_graph import has_recursion, jacobian_graph
from .kernel import Kernel
from .machine.native import compile_object


def jacobian_of(kernel: Kernel, y: Array, parameters: Array) -> Array:
    """Compute the Jacobian of the vector field.

    A recursion over the tree computes it.  Structures that the recursion does not support use
    `tangent_of`, with eight columns at once.

    Args:
        kernel: The kernel, already validated against Pinocchio.
        y: Reduced state, (size,).
        parameters: Parameters, (p,).
    Returns:
        (size, size): ∂ẏ/∂y.
    Raises:
        KernelMismatch: The code disagrees with differences of the kernel.
        InputError: The forces are not differentiable at most random states.
    """
    if not has_recursion(kernel.system, kernel.structure, kernel.forces):
        return jacobian_by_columns(tangent_of(kernel), y, parameters)
    return _evaluate(jacobian_code(kernel), y, parameters)


def jacobian_code(kernel: Kernel) -> NativeCode:
    """Return machine code (y, parameters) → ∂ẏ/∂y, row by row, compiled and validated once.

    Args:
        kernel: A kernel for which `has_recursion` is true.
    Returns:
        The machine code.
    """

    def compile_code() -> bytes:
        function, marks = jacobian_graph(kernel.system, kernel.structure, kernel.forces)
        return compile_object(function, "jacobian", marks)

    return derived_code(
        kernel,
        "jacobian",
        {"jacobian": 1},
        lambda _: compile_code(),
        lambda native: validate_jacobian(kernel, partial(_evaluate, native)),
    )


def _evaluate(native: NativeCode, y: Array, parameters: Array) -> Array:
    matrix = np.empty((len(y), len(y)))
    y, parameters = np.ascontiguousarray(y), np.ascontiguousarray(parameters)
    call_value(native.address, y, parameters, matrix.ravel())
    return matrix
