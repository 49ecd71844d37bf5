"""CasADi functions as JavaScript, instruction by instruction."""

from __future__ import annotations

import casadi as ca

from ...common.errors import UnsupportedOperationError

# {operation: JavaScript of its arguments a and b}.  Comparisons are numbers, as in CasADi.
_OPERATIONS = {
    ca.OP_ASSIGN: "{a}", ca.OP_ADD: "{a}+{b}", ca.OP_SUB: "{a}-{b}", ca.OP_MUL: "{a}*{b}",
    ca.OP_DIV: "{a}/{b}", ca.OP_NEG: "-{a}", ca.OP_SQ: "{a}*{a}", ca.OP_TWICE: "2*{a}",
    ca.OP_INV: "1/{a}", ca.OP_SQRT: "Math.sqrt({a})", ca.OP_SIN: "Math.sin({a})",
    ca.OP_COS: "Math.cos({a})", ca.OP_TAN: "Math.tan({a})", ca.OP_ASIN: "Math.asin({a})",
    ca.OP_ACOS: "Math.acos({a})", ca.OP_ATAN: "Math.atan({a})",
    ca.OP_ATAN2: "Math.atan2({a},{b})", ca.OP_FABS: "Math.abs({a})", ca.OP_EXP: "Math.exp({a})",
    ca.OP_LOG: "Math.log({a})", ca.OP_POW: "Math.pow({a},{b})", ca.OP_SIGN: "Math.sign({a})",
    ca.OP_CONSTPOW: "Math.pow({a},{b})", ca.OP_FMIN: "Math.min({a},{b})",
    ca.OP_FMAX: "Math.max({a},{b})", ca.OP_LT: "+({a}<{b})", ca.OP_LE: "+({a}<={b})",
    ca.OP_EQ: "+({a}==={b})", ca.OP_NE: "+({a}!=={b})", ca.OP_NOT: "+!{a}",
    ca.OP_AND: "+({a}&&{b})", ca.OP_OR: "+({a}||{b})", ca.OP_IF_ELSE_ZERO: "({a}?{b}:0)",
}  # fmt: skip


def to_javascript(name: str, function: ca.Function) -> str:
    """Write a function of one dense vector as JavaScript `name(y, out)`, which fills `out`.

    Args:
        name: Name of the JavaScript function.
        function: Function of SX expressions, y → out.
    Returns:
        The JavaScript function.
    Raises:
        UnsupportedOperationError: The function contains an operation without translation.
    """
    lines: list[str] = []
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        inputs, outputs = function.instruction_input(k), function.instruction_output(k)
        if operation == ca.OP_OUTPUT:
            lines.append(f"out[{outputs[1]}]=w{inputs[0]}")
        elif operation == ca.OP_CONST:
            lines.append(f"w{outputs[0]}={_number(function.instruction_constant(k))}")
        elif operation == ca.OP_INPUT:
            lines.append(f"w{outputs[0]}=y[{inputs[1]}]")
        elif operation in _OPERATIONS:
            a, b = f"w{inputs[0]}", f"w{inputs[-1]}"
            lines.append(f"w{outputs[0]}={_OPERATIONS[operation].format(a=a, b=b)}")
        else:
            raise UnsupportedOperationError(
                f"JavaScript: expected elementary operations, got CasADi's operation {operation}"
            )
    work = ",".join(f"w{k}" for k in range(function.sz_w()))
    let = f"let {work};\n" if work else ""
    return f"function {name}(y,out){{\n{let}{';'.join(lines)};\n}}\n"


def _number(value: float) -> str:
    """Write a number as JavaScript, which reads the same bits."""
    names = {"inf": "Infinity", "-inf": "-Infinity", "nan": "NaN"}
    return names.get(repr(float(value)), repr(float(value)))
