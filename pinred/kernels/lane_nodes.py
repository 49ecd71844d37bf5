"""The operations of a vector field whose identical branches are in SIMD lanes, in execution order.

CasADi's derivatives do not support the symbols that represent lane operations (`Mark`).
`tangent_lanes` and `adjoint_lanes` therefore differentiate these nodes themselves.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import casadi as ca

from ..reduction.tree.identical_branches import Lanes, Mark
from ..reduction.tree.scalars import Scalar


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
