"""Reverse-mode derivative of a vector field whose identical branches are in SIMD lanes.

The backward sweep visits every node (see `lane_nodes`) from the last to the first, and propagates
the adjoint of the result to the operands.  Instructions on values in lanes are propagated in lanes.
If lanes contribute to the adjoint of a scalar, their contributions are summed once, when the sweep
reaches the scalar.  The adjoint of a number extracted from a lane is added to that lane, and the
adjoint of a sum over lanes is added to all lanes.
"""

from __future__ import annotations

import casadi as ca

from ..reduction.tree.identical_branches import Lanes, Mark
from ..reduction.tree.scalars import Scalar, add, mul
from .lane_nodes import Node, record


def adjoint_in_lanes(rate: ca.Function, marks: list[Mark], lanes: Lanes, name: str) -> ca.Function:
    """Build the reverse-mode derivative of a vector field with identical branches in lanes.

    Args:
        rate: Vector field (y, parameters, symbols) → (operands, ẏ), built with another Lanes
            object.
        marks: Lane operations of `rate`, one per symbol.
        lanes: Lanes object that receives the lane operations of the adjoint.
        name: Name of the adjoint Function.
    Returns:
        Function (y, parameters, λ) → derivatives of λᵀ ẏ with respect to y, followed by those
        with respect to the parameters.
    """
    y, p = ca.SX.sym("y", rate.numel_in(0)), ca.SX.sym("p", rate.numel_in(1))
    covector = ca.SX.sym("l", rate.numel_out(1))
    tape, inputs, outputs = record(rate, marks, lanes, y, p)
    for row, node in outputs.items():
        node.adjoint = add(node.adjoint, covector[row])
    for node in reversed(tape):
        _propagate(node, lanes)
    adjoints = [_total_adjoint(inputs[which, k], lanes) if (which, k) in inputs else 0.0
              for which, column in ((0, y), (1, p)) for k in range(column.numel())]  # fmt: skip
    return lanes.function(name, [y, p, covector], ca.vertcat(ca.SX(0, 1), *adjoints))


def _propagate(node: Node, lanes: Lanes) -> None:
    """Add the adjoint of a node to the adjoints of its operands."""
    adjoint = _total_adjoint(node, lanes)
    if isinstance(adjoint, float) and adjoint == 0.0:
        return
    mark = node.mark
    if mark is None:
        for parent, rule in node.parents:
            product = mul(adjoint, rule)
            if node.width > 1 and parent.width == 1:
                parent.from_lanes = add(parent.from_lanes, product)
                parent.lanes = node.width
            else:
                parent.adjoint = add(parent.adjoint, product)
    elif mark.kind == "pack":
        for lane, (parent, _) in enumerate(node.parents):
            parent.adjoint = add(parent.adjoint, lanes.lane(adjoint, lane, mark.width))
    else:
        ((parent, _),) = node.parents
        if mark.kind == "sum":
            parent.adjoint = add(parent.adjoint, adjoint)
        else:
            if parent.from_extracts is None:
                parent.from_extracts = [0.0] * mark.width
            parent.from_extracts[mark.lane] = add(parent.from_extracts[mark.lane], adjoint)


def _total_adjoint(node: Node, lanes: Lanes) -> Scalar:
    """Return the total adjoint of a node."""
    adjoint = node.adjoint
    if not (isinstance(node.from_lanes, float) and node.from_lanes == 0.0):
        adjoint = add(adjoint, lanes.sum(node.from_lanes, node.lanes))
    if node.from_extracts is not None:
        adjoint = add(adjoint, lanes.pack(node.from_extracts))
    return adjoint
