"""The Jacobian of a kernel's vector field with respect to the reduced state.

Kernels of open trees of hinges and slides have it as CasADi expressions, by a recursion.

The chain rule connects the derivatives of the sweep (see reduction/tree/articulated_sweep.py) with
those of forces and of the base, which CasADi computes.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import casadi as ca
import numpy as np

from ..common.arrays import Array
from ..common.machine_code import NativeCode
from ..forces.force_model import ForceModel
from ..reduction.tree.articulated_sweep import sweep_jacobian
from ..reduction.tree.body_frames import bodies_of
from ..reduction.tree.identical_branches import Lanes, Mark
from ..reduction.tree.scalars import Mat
from ..system.system import System
from .derived_code import derived_code, jacobian_by_columns, tangent_of, validate_jacobian
from .differentiable import call_value
from .kernel import Kernel
from .machine.native import compile_object
from .reduced_graph import ReducedGraph
from .state_layout import Structure, layout_of


def has_recursion(system: System, structure: Structure, forces: ForceModel | None) -> bool:
    """Return whether `jacobian_graph` supports a system and structure.

    Balls, joints that follow others, closed loops, prescribed joints and variable bodies are not
    supported.
    """
    followers = system.space.balls or system.coupled is not None or system.closure is not None
    prescribed = layout_of(system, structure, forces).prescribed
    return not (followers or prescribed or structure.freed)


def jacobian_graph(
    system: System, structure: Structure, forces: ForceModel | None
) -> tuple[ca.Function, Sequence[Mark]]:
    """Build the Jacobian of the vector field.

    Args:
        system: The system.
        structure: Structure of the reduced equations, for which `has_recursion` is true.
        forces: Forces on the system, or None.
    Returns:
        Function (y, parameters) → ∂ẏ/∂y, row by row, and its marks.
    """
    lanes = Lanes(joins=False)
    graph = ReducedGraph(system, structure, forces, lanes, cut=True)
    y, cuts = graph.y, graph.cuts
    sweep = _matrix(sweep_jacobian(graph.swept, bodies_of(system), system.group.axes, lanes))
    through = sweep @ ca.jacobian(graph.sweep_inputs, y)
    jacobian = ca.jacobian(graph.rates, y) + ca.jacobian(graph.rates, cuts) @ through
    (jacobian,) = ca.substitute([jacobian], [cuts], [graph.sweep_results])
    column = ca.vec(ca.densify(jacobian).T)
    function = lanes.function("jacobian", [y, graph.parameters], column)
    return function, lanes.marks["jacobian"]


def _matrix(rows: Mat) -> ca.SX:
    """Return a matrix without its entries that are exactly zero."""
    entries = [
        (i, k, entry)
        for i, row in enumerate(rows)
        for k, entry in enumerate(row)
        if not (isinstance(entry, float) and entry == 0.0)
    ]
    at = [i for i, _, _ in entries], [k for _, k, _ in entries]
    matrix = ca.SX.zeros(ca.Sparsity.triplet(len(rows), len(rows), *at))
    for i, k, entry in entries:
        matrix[i, k] = entry
    return matrix


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
