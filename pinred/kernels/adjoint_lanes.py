"""The adjoint of a vector field whose limbs are lanes: a sweep back over its instructions.

CasADi's own reverse mode knows nothing of marks.  Here every instruction is gone through once more,
from the last to the first, and hands the slope of its value on to its operands; in lanes where it
is in lanes.  What one number for all lanes gets from lanes is summed over them once, at its end; a
number taken out of a lane gives its slope back to that lane, and a sum gives its own to all.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import casadi as ca

from ..reduction.tree.limbs import Lanes, Mark
from ..reduction.tree.scalars import Scalar, add, mul


@dataclass
class _Node:
    """A number or lanes of numbers on the way.

    value: its expression.  parents: nodes it is made of, with ∂value/∂parent each.  mark: how it
    came into being, if by a mark.  slope: what it has got so far; from_lanes: of that, what is in
    lanes though it is one number; taken: what single lanes have got.
    """

    value: Scalar
    width: int = 1
    parents: list[tuple[_Node, Any]] = field(default_factory=list)
    mark: Mark | None = None
    slope: Scalar = 0.0
    from_lanes: Scalar = 0.0
    lanes: int = 1
    taken: list[Scalar] | None = None


def adjoint_in_lanes(rate: ca.Function, marks: list[Mark], lanes: Lanes, name: str) -> ca.Function:
    """Return (y, parameters, λ) → slopes of λᵀ ẏ by y, then by the parameters, marked in `lanes`.

    rate: (y, parameters, symbols) → (operands, ẏ), of other Lanes, with its marks.
    """
    y, p = ca.SX.sym("y", rate.numel_in(0)), ca.SX.sym("p", rate.numel_in(1))
    covector = ca.SX.sym("l", rate.numel_out(1))
    tape, inputs, outputs = _recorded(rate, marks, lanes, y, p)
    for row, node in outputs.items():
        node.slope = add(node.slope, covector[row])
    for node in reversed(tape):
        _hand_on(node, lanes)
    slopes = [_finished(inputs[which, k], lanes) if (which, k) in inputs else 0.0
              for which, column in ((0, y), (1, p)) for k in range(column.numel())]  # fmt: skip
    return lanes.function(name, [y, p, covector], ca.vertcat(ca.SX(0, 1), *slopes))


def _recorded(
    rate: ca.Function, marks: list[Mark], lanes: Lanes, y: ca.SX, p: ca.SX
) -> tuple[list[_Node], dict[tuple[int, int], _Node], dict[int, _Node]]:
    """Return all nodes in order, those of the inputs, and those of the outputs by row."""
    tape: list[_Node] = []
    inputs: dict[tuple[int, int], _Node] = {}
    outputs: dict[int, _Node] = {}
    here: dict[int, _Node] = {}  # by register, as of the current instruction
    marked: list[_Node] = []
    operands: list[_Node] = []
    for k in range(rate.n_instructions()):
        op, arguments = rate.instruction_id(k), rate.instruction_input(k)
        if op == ca.OP_CONST:
            node = _Node(float(rate.instruction_constant(k)))
        elif op == ca.OP_INPUT:
            which, entry = arguments
            if which == 2:
                node = marked[entry]
            else:
                if (which, entry) not in inputs:
                    inputs[which, entry] = _Node((y, p)[which][entry])
                node = inputs[which, entry]
        elif op == ca.OP_OUTPUT:
            which, row = rate.instruction_output(k)
            if which == 1:
                outputs[row] = here[arguments[0]]
                continue
            operands.append(here[arguments[0]])
            mark = marks[len(marked)]
            if len(operands) == len(mark.operands):
                marked.append(_of_mark(mark, operands, lanes))
                tape.append(marked[-1])
                operands = []
            continue
        else:
            node = _of_operation(op, [here[i] for i in arguments])
            tape.append(node)
        here[rate.instruction_output(k)[0]] = node
    return tape, inputs, outputs


def _of_operation(op: int, parents: list[_Node]) -> _Node:
    values = [ca.SX(parent.value) for parent in parents]
    made = ca.SX.unary(op, values[0]) if len(values) == 1 else ca.SX.binary(op, *values)
    slopes = _slopes(op, values)
    pairs = list(zip(parents, slopes, strict=True))
    return _Node(made, max(parent.width for parent in parents), pairs)


def _slopes(op: int, values: list[ca.SX]) -> list[Scalar]:
    """Return the derivatives of an operation by its operands, constants as floats."""
    if op not in _RULES:
        symbols = [ca.SX.sym("a"), ca.SX.sym("b")][: len(values)]
        made = ca.SX.unary(op, *symbols) if len(values) == 1 else ca.SX.binary(op, *symbols)
        rules = [ca.densify(ca.jacobian(made, symbol)) for symbol in symbols]
        _RULES[op] = ca.Function("rule", symbols, rules)
    found = _RULES[op](*values)
    each = [found] if len(values) == 1 else list(found)
    return [float(slope) if slope.is_constant() else slope for slope in each]


_RULES: dict[int, ca.Function] = {}


def _of_mark(mark: Mark, operands: list[_Node], lanes: Lanes) -> _Node:
    if mark.kind == "pack":
        value = lanes.pack([operand.value for operand in operands])
        width = mark.width
    elif mark.kind == "lane":
        value, width = lanes.lane(operands[0].value, mark.lane, mark.width), 1
    else:
        value, width = lanes.sum(operands[0].value, mark.width), 1
    return _Node(value, width, [(operand, 1.0) for operand in operands], mark)


def _hand_on(node: _Node, lanes: Lanes) -> None:
    """Give the slope of a node to those it is made of."""
    slope = _finished(node, lanes)
    if isinstance(slope, float) and slope == 0.0:
        return
    mark = node.mark
    if mark is None:
        for parent, rule in node.parents:
            part = mul(slope, rule)
            if node.width > 1 and parent.width == 1:
                parent.from_lanes = add(parent.from_lanes, part)
                parent.lanes = node.width
            else:
                parent.slope = add(parent.slope, part)
    elif mark.kind == "pack":
        for lane, (parent, _) in enumerate(node.parents):
            parent.slope = add(parent.slope, lanes.lane(slope, lane, mark.width))
    else:
        ((parent, _),) = node.parents
        if mark.kind == "sum":
            parent.slope = add(parent.slope, slope)
        else:
            if parent.taken is None:
                parent.taken = [0.0] * mark.width
            parent.taken[mark.lane] = add(parent.taken[mark.lane], slope)


def _finished(node: _Node, lanes: Lanes) -> Scalar:
    """Return the whole slope of a node."""
    slope = node.slope
    if not (isinstance(node.from_lanes, float) and node.from_lanes == 0.0):
        slope = add(slope, lanes.sum(node.from_lanes, node.lanes))
    if node.taken is not None:
        slope = add(slope, lanes.pack(node.taken))
    return slope
