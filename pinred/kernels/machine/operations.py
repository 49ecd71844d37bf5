"""LLVM IR of CasADi's scalar operations: single lines, calls, and helper functions."""

from __future__ import annotations

from functools import cache

import casadi as ca

FLAGS = "contract reassoc"
NAMES = {getattr(ca, key): key[3:].lower() for key in dir(ca) if key.startswith("OP_")}

# Operations that take one line of IR: {} stands for an operand, T for the type of the operands.
LINES = {
    ca.OP_ADD: f"fadd {FLAGS} {{T}} {{}}, {{}}",
    ca.OP_SUB: f"fsub {FLAGS} {{T}} {{}}, {{}}",
    ca.OP_MUL: f"fmul {FLAGS} {{T}} {{}}, {{}}",
    ca.OP_DIV: f"fdiv {FLAGS} arcp {{T}} {{}}, {{}}",
    ca.OP_NEG: f"fneg {FLAGS} {{T}} {{}}",
    ca.OP_SQ: f"fmul {FLAGS} {{T}} {{0}}, {{0}}",
    ca.OP_TWICE: f"fadd {FLAGS} {{T}} {{0}}, {{0}}",
    ca.OP_INV: f"fdiv {FLAGS} arcp {{T}} {{one}}, {{}}",
}
# Operations that call LLVM intrinsics or libm, with the number of arguments.
CALLS = {
    ca.OP_SQRT: ("llvm.sqrt.f64", 1), ca.OP_FABS: ("llvm.fabs.f64", 1),
    ca.OP_FLOOR: ("llvm.floor.f64", 1), ca.OP_CEIL: ("llvm.ceil.f64", 1),
    ca.OP_COPYSIGN: ("llvm.copysign.f64", 2), ca.OP_FMIN: ("llvm.minnum.f64", 2),
    ca.OP_FMAX: ("llvm.maxnum.f64", 2),
    ca.OP_EXP: ("exp", 1), ca.OP_LOG: ("log", 1), ca.OP_LOG1P: ("log1p", 1),
    ca.OP_EXPM1: ("expm1", 1), ca.OP_POW: ("pow", 2), ca.OP_CONSTPOW: ("pow", 2),
    ca.OP_TAN: ("tan", 1), ca.OP_ASIN: ("asin", 1), ca.OP_ACOS: ("acos", 1),
    ca.OP_ATAN: ("atan", 1), ca.OP_ATAN2: ("atan2", 2), ca.OP_HYPOT: ("hypot", 2),
    ca.OP_SINH: ("sinh", 1), ca.OP_COSH: ("cosh", 1), ca.OP_TANH: ("tanh", 1),
    ca.OP_ASINH: ("asinh", 1), ca.OP_ACOSH: ("acosh", 1), ca.OP_ATANH: ("atanh", 1),
    ca.OP_ERF: ("erf", 1), ca.OP_FMOD: ("fmod", 2), ca.OP_REMAINDER: ("remainder", 2),
}  # fmt: skip
# Operations that take several lines.  Results are 1 (true) or 0 (false).  As operands, all numbers
# except ±0 are true, including NaN.
_TRUTH = {
    ca.OP_LT: ["%t = fcmp olt double %a, %b"],
    ca.OP_LE: ["%t = fcmp ole double %a, %b"],
    ca.OP_EQ: ["%t = fcmp oeq double %a, %b"],
    ca.OP_NE: ["%t = fcmp une double %a, %b"],
    ca.OP_NOT: ["%t = fcmp oeq double %a, 0.0"],
    ca.OP_AND: [
        "%p = fcmp une double %a, 0.0", "%q = fcmp une double %b, 0.0", "%t = and i1 %p, %q",
    ],
    ca.OP_OR: [
        "%p = fcmp une double %a, 0.0", "%q = fcmp une double %b, 0.0", "%t = or i1 %p, %q",
    ],
}  # fmt: skip
_CHOICES = {
    ca.OP_IF_ELSE_ZERO: [
        "%p = fcmp oeq double %a, 0.0",
        "%r = select i1 %p, double 0.0, double %b",
    ],
    ca.OP_SIGN: [
        "%p = fcmp ogt double %a, 0.0",
        "%q = fcmp olt double %a, 0.0",
        "%s = select i1 %p, double 1.0, double %a",
        "%r = select i1 %q, double -1.0, double %s",
    ],
}
BODIES = _CHOICES | {op: [*lines, "%r = uitofp i1 %t to double"] for op, lines in _TRUTH.items()}
_UNARY = {ca.OP_NOT, ca.OP_SIGN}
PURE = "nounwind willreturn memory(none)"
RESERVED = {name for name, _ in CALLS.values()} | {"sin", "cos", "sincos"}


@cache
def templates() -> dict[int, str]:
    """Return the template line of IR of each operation, by CasADi's operation code."""
    calls = {op: (f"@{name}", count) for op, (name, count) in CALLS.items()}
    calls |= {op: (f"@pinred.{NAMES[op]}", 1 if op in _UNARY else 2) for op in BODIES}
    return LINES | {
        op: f"call double {name}({', '.join(['double {}'] * count)})"
        for op, (name, count) in calls.items()
    }


def declaration(name: str, count: int) -> str:
    """Return the LLVM declaration of a function of `count` numbers."""
    return f"declare double @{name}({', '.join(['double'] * count)}) {PURE}"


def helper(op: int) -> str:
    """Return the LLVM function that implements an operation of several lines."""
    arguments = "double %a" if op in _UNARY else "double %a, double %b"
    body = "\n".join(BODIES[op])
    return (
        f"define internal double @pinred.{NAMES[op]}({arguments}) alwaysinline {{\n"
        f"{body}\nret double %r\n}}"
    )
