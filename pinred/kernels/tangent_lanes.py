"""Forward-mode derivative of a vector field whose identical branches are in SIMD lanes.

The tangent of a value in lanes has the same lanes.  SIMD lanes thus serve the branches of the robot
for one direction, while `Differentiable.tangent` uses them for eight directions.
"""

from __future__ import annotations

import casadi as ca

from ..reduction.tree.identical_branches import Lanes, Mark
from ..reduction.tree.scalars import Scalar, add, mul
from .lane_nodes import Node, record


def tangent_in_lanes(rate: ca.Function, marks: list[Mark], lanes: Lanes, name: str) -> ca.Function:
    """Build a vector field together with its derivative along one direction.

    Args:
        rate: Vector field (y, parameters, symbols) → (operands, ẏ), built with another Lanes
            object.
        marks: Lane operations of `rate`, one per symbol.
        lanes: Lanes object that receives the lane operations of the derivative.
        name: Name of the Function.
    Returns:
        Function (y, parameters, δy, δparameters) → (ẏ, δẏ).
    """
    y, p = ca.SX.sym("y", rate.numel_in(0)), ca.SX.sym("p", rate.numel_in(1))
    directions = ca.SX.sym("dy", y.numel()), ca.SX.sym("dp", p.numel())
    tape, inputs, outputs = record(rate, marks, lanes, y, p)
    for (which, entry), node in inputs.items():
        node.tangent = directions[which][entry]
    for node in tape:
        node.tangent = _tangent(node, lanes)
    rows = [outputs[row] for row in range(rate.numel_out(1))]
    both = [*(node.value for node in rows), *(node.tangent for node in rows)]
    return lanes.function(name, [y, p, *directions], ca.vertcat(ca.SX(0, 1), *both))


def _tangent(node: Node, lanes: Lanes) -> Scalar:
    """Return the tangent of a node from the tangents of its operands."""
    mark, tangent = node.mark, 0.0
    if mark is None:
        for parent, derivative in node.parents:
            tangent = add(tangent, mul(parent.tangent, derivative))
        return tangent
    operands = [parent.tangent for parent, _ in node.parents]
    if mark.kind == "pack":
        return lanes.pack(operands)
    (packed,) = operands
    if mark.kind == "lane":
        return lanes.lane(packed, mark.lane, mark.width)
    return lanes.sum(packed, mark.width)
