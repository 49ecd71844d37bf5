"""Derivatives of a vector field whose identical branches are in SIMD lanes.

CasADi's derivatives do not support the symbols that represent lane operations (`Mark`). The
operations are therefore recorded as nodes, in execution order, and differentiated here.

Forward mode: the tangent of a value in lanes has the same lanes. SIMD lanes thus serve the branches
of the robot for one direction, while `Differentiable.tangent` uses them for eight directions.

Reverse mode: the backward sweep visits every node from the last to the first, and propagates the
adjoint of the result to the operands. Instructions on values in lanes are propagated in lanes. If
lanes contribute to the adjoint of a scalar, their contributions are summed once, when the sweep
reaches the scalar. The adjoint of a number extracted from a lane is added to that lane, and the
adjoint of a sum over lanes is added to all lanes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import casadi as ca

from ..reduction.tree.identical_branches import Lanes, Mark
from ..reduction.tree.scalars import Scalar, add, mul


@dataclass
class Node:
    """A node of the computational graph: a scalar, or a value with one number per lane.

    Attributes:
        value: CasADi expression of the value.
        width: Number of lanes.
        parents: Operands, with the derivative of the value with respect to each.
        mark: The lane operation that created the value, or None for an ordinary operation.
        tangent: Derivative of the value along a direction of the inputs.
        adjoint: Sum of the adjoint contributions received so far.
        from_lanes: Adjoint contributions to a scalar that are not yet summed over the lanes.
        lanes: Number of lanes of `from_lanes`.
        from_extracts: Adjoint of each number that was extracted from a lane of this value.
    """

    value: Scalar
    width: int = 1
    parents: list[tuple[Node, Any]] = field(default_factory=list)
    mark: Mark | None = None
    tangent: Scalar = 0.0
    adjoint: Scalar = 0.0
    from_lanes: Scalar = 0.0
    lanes: int = 1
    from_extracts: list[Scalar] | None = None


def record(
    rate: ca.Function, marks: list[Mark], lanes: Lanes, y: ca.SX, p: ca.SX
) -> tuple[list[Node], dict[tuple[int, int], Node], dict[int, Node]]:
    """Record the nodes of a vector field.

    Args:
        rate: Vector field (y, parameters, symbols) → (operands, ẏ), built with another Lanes
            object.
        marks: Lane operations of `rate`, one per symbol.
        lanes: Lanes object that receives the same lane operations.
        y: Symbols of the state.
        p: Symbols of the parameters.
    Returns:
        All nodes in execution order; the input nodes by (0 for y or 1 for p, entry); and the output
        nodes by row.
    """
    tape: list[Node] = []
    inputs: dict[tuple[int, int], Node] = {}
    outputs: dict[int, Node] = {}
    registers: dict[int, Node] = {}  # node currently stored in each register
    marked: list[Node] = []
    operands: list[Node] = []
    for k in range(rate.n_instructions()):
        op, arguments = rate.instruction_id(k), rate.instruction_input(k)
        if op == ca.OP_CONST:
            node = Node(float(rate.instruction_constant(k)))
        elif op == ca.OP_INPUT:
            which, entry = arguments
            if which == 2:
                node = marked[entry]
            else:
                if (which, entry) not in inputs:
                    inputs[which, entry] = Node((y, p)[which][entry])
                node = inputs[which, entry]
        elif op == ca.OP_OUTPUT:
            which, row = rate.instruction_output(k)
            if which == 1:
                outputs[row] = registers[arguments[0]]
                continue
            operands.append(registers[arguments[0]])
            mark = marks[len(marked)]
            if len(operands) == len(mark.operands):
                marked.append(_mark_node(mark, operands, lanes))
                tape.append(marked[-1])
                operands = []
            continue
        else:
            node = _operation_node(op, [registers[i] for i in arguments])
            tape.append(node)
        registers[rate.instruction_output(k)[0]] = node
    return tape, inputs, outputs


def _operation_node(op: int, parents: list[Node]) -> Node:
    values = [ca.SX(parent.value) for parent in parents]
    result = ca.SX.unary(op, values[0]) if len(values) == 1 else ca.SX.binary(op, *values)
    pairs = list(zip(parents, _local_derivatives(op, values), strict=True))
    return Node(result, max(parent.width for parent in parents), pairs)


def _local_derivatives(op: int, values: list[ca.SX]) -> list[Scalar]:
    """Return the derivative of an operation with respect to each operand; constants are floats."""
    if op not in _RULES:
        symbols = [ca.SX.sym("a"), ca.SX.sym("b")][: len(values)]
        result = ca.SX.unary(op, *symbols) if len(values) == 1 else ca.SX.binary(op, *symbols)
        rules = [ca.densify(ca.jacobian(result, symbol)) for symbol in symbols]
        _RULES[op] = ca.Function("rule", symbols, rules)
    results = _RULES[op](*values)
    derivatives = [results] if len(values) == 1 else list(results)
    return [float(entry) if entry.is_constant() else entry for entry in derivatives]


_RULES: dict[int, ca.Function] = {}  # by operation code: its partial derivatives


def _mark_node(mark: Mark, operands: list[Node], lanes: Lanes) -> Node:
    if mark.kind == "pack":
        value = lanes.pack([operand.value for operand in operands])
        width = mark.width
    elif mark.kind == "lane":
        value, width = lanes.lane(operands[0].value, mark.lane, mark.width), 1
    else:
        value, width = lanes.sum(operands[0].value, mark.width), 1
    return Node(value, width, [(operand, 1.0) for operand in operands], mark)


def tangent_in_lanes(
    rate: ca.Function, marks: list[Mark], lanes: Lanes, name: str, *, joined: bool = False
) -> ca.Function:
    """Build a vector field together with its derivative along one direction.

    Args:
        rate: Vector field (y, parameters, symbols) → (operands, ẏ), built with another Lanes
            object.
        marks: Lane operations of `rate`, one per symbol.
        lanes: Lanes object that receives the lane operations of the derivative.
        name: Name of the Function.
        joined: Whether each column is followed by its direction in one input.
    Returns:
        Function (y, parameters, δy, δparameters) → (ẏ, δẏ), or ((y, δy), (parameters,
        δparameters)) → (ẏ, δẏ).
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
    columns = [y, p, *directions]
    if joined:
        columns = [ca.vertcat(*pair) for pair in zip((y, p), directions, strict=True)]
    return lanes.function(name, columns, ca.vertcat(ca.SX(0, 1), *both))


def joined_tangent(rate: ca.Function, name: str) -> ca.Function:
    """Build a vector field with its derivative, without lanes; see `tangent_in_lanes`.

    Args:
        rate: Vector field (y, parameters) → ẏ.
        name: Name of the Function.
    Returns:
        Function ((y, δy), (parameters, δparameters), nothing) → (nothing, (ẏ, δẏ)).
    """
    y, p = rate.sx_in()
    none = ca.SX(0, 1)
    plain = ca.Function("rate", [y, p, none], [none, ca.densify(rate(y, p))], {"cse": True})
    return tangent_in_lanes(plain, [], Lanes(), name, joined=True)


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
