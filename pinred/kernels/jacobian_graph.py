"""The Jacobian of the vector field as CasADi expressions, by a recursion over the tree.

The chain rule connects the derivatives of the sweep (see reduction/tree/sweep_jacobian.py) with
those of forces and of the base, which CasADi computes.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from ..forces.force_model import ForceModel
from ..reduction.tree.body_frames import bodies_of
from ..reduction.tree.identical_branches import Lanes, Mark
from ..reduction.tree.scalars import Mat
from ..reduction.tree.sweep_jacobian import sweep_jacobian
from ..system.system import System
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
    whole = ca.jacobian(graph.rates, y) + ca.jacobian(graph.rates, cuts) @ through
    (whole,) = ca.substitute([whole], [cuts], [graph.sweep_results])
    column = ca.vec(ca.densify(whole).T)
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
