"""CasADi functions as JavaScript, instruction by instruction."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product
from string import ascii_letters

import casadi as ca

from ...common.errors import UnsupportedOperationError

# {operation: JavaScript of its arguments}.  Comparisons are numbers, as in CasADi.
_OPERATIONS = {
    ca.OP_ASSIGN: "{0}", ca.OP_ADD: "{0}+{1}", ca.OP_SUB: "{0}-{1}", ca.OP_MUL: "{0}*{1}",
    ca.OP_DIV: "{0}/{1}", ca.OP_NEG: "-{0}", ca.OP_SQ: "{0}*{0}", ca.OP_TWICE: "2*{0}",
    ca.OP_INV: "1/{0}", ca.OP_SQRT: "Math.sqrt({0})", ca.OP_SIN: "Math.sin({0})",
    ca.OP_COS: "Math.cos({0})", ca.OP_TAN: "Math.tan({0})", ca.OP_ASIN: "Math.asin({0})",
    ca.OP_ACOS: "Math.acos({0})", ca.OP_ATAN: "Math.atan({0})",
    ca.OP_ATAN2: "Math.atan2({0},{1})", ca.OP_FABS: "Math.abs({0})", ca.OP_EXP: "Math.exp({0})",
    ca.OP_LOG: "Math.log({0})", ca.OP_POW: "Math.pow({0},{1})", ca.OP_SIGN: "Math.sign({0})",
    ca.OP_CONSTPOW: "Math.pow({0},{1})", ca.OP_FMIN: "Math.min({0},{1})",
    ca.OP_FMAX: "Math.max({0},{1})", ca.OP_LT: "+({0}<{1})", ca.OP_LE: "+({0}<={1})",
    ca.OP_EQ: "+({0}==={1})", ca.OP_NE: "+({0}!=={1})", ca.OP_NOT: "+!{0}",
    ca.OP_AND: "+({0}&&{1})", ca.OP_OR: "+({0}||{1})", ca.OP_IF_ELSE_ZERO: "({0}?{1}:0)",
}  # fmt: skip


_RESERVED = {"y", "do", "if", "in", "for", "let", "new", "out", "try", "var"}
_LONGEST = 300  # largest number of characters of an expression that becomes part of another one


@dataclass
class _Value:
    """A value of a function.

    Attributes:
        text: Its JavaScript: an expression, or the name of its variable.
        atom: Whether the text needs no parentheses inside other expressions.
        names: Variables in the text, as often as they appear.
        uses: Number of appearances of the value in other texts.
    """

    text: str = ""
    atom: bool = False
    names: list[str] = field(default_factory=list)
    uses: int = 0


def to_javascript(name: str, function: ca.Function) -> str:
    """Write a function of one dense vector as JavaScript `name(y, out)`, which fills `out`.

    Constants, entries of y, and values that are used once become parts of other expressions, so
    the operations and their results stay the same.

    Args:
        name: Name of the JavaScript function.
        function: Function of SX expressions, y → out.
    Returns:
        The JavaScript function.
    Raises:
        UnsupportedOperationError: The function contains an operation without translation.
    """
    lines: list[str] = []
    variables = _Variables()
    for template, value, operands in _instructions(function):
        texts = [one.text if one.atom else f"({one.text})" for one in operands]
        value.text = template.format(*texts)
        value.names = [n for k, one in enumerate(operands) for n in one.names * _count(template, k)]
        if not operands and value.uses * (len(template) - 2) <= len(template) + 4:
            value.atom = not template.startswith("-")  # a constant or an entry of y
        elif not value.uses:  # an output
            lines.append(value.text)
            variables.release(value.names)
        elif value.uses > 1 or not operands or len(value.text) > _LONGEST:
            variables.release(value.names)
            new = variables.take(value.uses)
            lines.append(f"{new}={value.text}")
            value.text, value.atom, value.names = new, True, [new]
    let = f"let {','.join(variables.all)};\n" if variables.all else ""
    return f"function {name}(y,out){{\n{let}{';'.join(lines)};\n}}\n"


def _instructions(function: ca.Function) -> list[tuple[str, _Value, list[_Value]]]:
    """Return the template, the value and the operands of each instruction, with counted uses."""
    registers: dict[int, _Value] = {}
    steps = []
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        inputs, outputs = function.instruction_input(k), function.instruction_output(k)
        operands: list[_Value] = []
        if operation == ca.OP_CONST:
            template = _number(function.instruction_constant(k))
        elif operation == ca.OP_INPUT:
            template = f"y[{inputs[1]}]"
        elif operation == ca.OP_OUTPUT:
            template, operands = f"out[{outputs[1]}]={{0}}", [registers[inputs[0]]]
        elif operation in _OPERATIONS:
            template = _OPERATIONS[operation]
            operands = [registers[index] for index in inputs[: 1 + ("{1}" in template)]]
        else:
            raise UnsupportedOperationError(
                f"JavaScript: expected elementary operations, got CasADi's operation {operation}"
            )
        for place, operand in enumerate(operands):
            operand.uses += _count(template, place)
        value = _Value()
        if operation != ca.OP_OUTPUT:
            registers[outputs[0]] = value
        steps.append((template, value, operands))
    return [step for step in steps if step[1].uses or step[0].startswith("out[")]


def _count(template: str, place: int) -> int:
    """Return how often an operand appears in a template."""
    return template.count(f"{{{place}}}")


class _Variables:
    """Names of variables, which are used again after the last appearance of their values."""

    def __init__(self) -> None:
        self.all: list[str] = []
        self._free: list[str] = []
        self._left: dict[str, int] = {}
        self._new = (
            name
            for size in (1, 2, 3)
            for name in map("".join, product(ascii_letters, repeat=size))
            if name not in _RESERVED
        )

    def take(self, uses: int) -> str:
        """Return a variable for a value that appears `uses` times."""
        if not self._free:
            self.all.append(next(self._new))
            self._free.append(self.all[-1])
        name = self._free.pop()
        self._left[name] = uses
        return name

    def release(self, names: list[str]) -> None:
        """Count appearances of variables."""
        for name in names:
            self._left[name] -= 1
            if not self._left[name]:
                self._free.append(name)


def _number(value: float) -> str:
    """Write a number as JavaScript, which reads the same bits."""
    names = {"inf": "Infinity", "-inf": "-Infinity", "nan": "NaN"}
    return names.get(repr(float(value)), repr(float(value)))
