"""Lowering: from a CasADi Function to LLVM IR.

The instructions of a Function are written down one line each: registers become SSA values, so
nothing is kept on a stack.  What depends on numbers packed into lanes becomes vector
instructions.  Sine and cosine are the one thing that libm is too slow for: they are gathered
into batches of angles that are known at the same time, and each batch is one vector
computation of both.

The floating-point flags are `contract` and `reassoc`, and `arcp` in divisions: two quotients
of one divisor may become products with 1/y, which differs where 1/y overflows (|y| < 6e-309).
Not `nnan` or `ninf`, and not `nsz` either: together with `reassoc` it turns (x + y) − x into
y, and a NaN in x is gone.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import casadi as ca

from ...common.errors import UnsupportedOperationError
from ...reduction.tree.limbs import Mark
from .sincos import LANES, constant, sincos_ir, vector

_FLAGS = "contract reassoc"
_NAMES = {getattr(ca, key): key[3:].lower() for key in dir(ca) if key.startswith("OP_")}

# One line of IR each; {} are the operands, T their type.
_LINES = {
    ca.OP_ADD: f"fadd {_FLAGS} {{T}} {{}}, {{}}",
    ca.OP_SUB: f"fsub {_FLAGS} {{T}} {{}}, {{}}",
    ca.OP_MUL: f"fmul {_FLAGS} {{T}} {{}}, {{}}",
    ca.OP_DIV: f"fdiv {_FLAGS} arcp {{T}} {{}}, {{}}",
    ca.OP_NEG: f"fneg {_FLAGS} {{T}} {{}}",
    ca.OP_SQ: f"fmul {_FLAGS} {{T}} {{0}}, {{0}}",
    ca.OP_TWICE: f"fadd {_FLAGS} {{T}} {{0}}, {{0}}",
    ca.OP_INV: f"fdiv {_FLAGS} arcp {{T}} {{one}}, {{}}",
}
# Functions of LLVM itself and of libm, with the number of their arguments.
_CALLS = {
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
# What takes more than one line: a truth value is 1 or 0, anything but ±0 is true, NaN too.
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
_BODIES = _CHOICES | {op: [*lines, "%r = uitofp i1 %t to double"] for op, lines in _TRUTH.items()}
_UNARY = {ca.OP_NOT, ca.OP_SIGN}
_PURE = "nounwind willreturn memory(none)"
_LIBM_SINCOS = [f"declare double @{name}(double) {_PURE}" for name in ("sin", "cos")]
_UNLIKELY = '!0 = !{!"branch_weights", i32 100000, i32 1}'
RESERVED = {name for name, _ in _CALLS.values()} | {"sin", "cos", "sincos"}


class _Writer:
    """The lines of one function, in stages.

    Stage 0 needs no sine or cosine; those of its values are computed after it; stage 1 needs
    these; and so on.  Most kernels have two.
    """

    def __init__(self) -> None:
        self.stages: list[list[str]] = [[]]
        self.angles: list[list[str]] = [[]]  # per stage, the arguments of its sines and cosines
        self.numbers: dict[str, int] = {}  # of every angle

    def angle(self, value: str, stage: int) -> int:
        """Return the number of an angle known in a stage."""
        if value not in self.numbers:
            self.numbers[value] = len(self.numbers)
            self.angles[stage].append(value)
            if stage + 1 == len(self.stages):
                self.stages.append([])
                self.angles.append([])
        return self.numbers[value]

    def body(self) -> tuple[list[str], set[int]]:
        """Return all lines, and the sizes of the batches of angles."""
        lines: list[str] = []
        widths = set()
        for stage, angles in zip(self.stages, self.angles, strict=True):
            lines += stage
            while angles:
                width = next(w for w in LANES if w <= len(angles))
                batch, angles = angles[:width], angles[width:]
                lines += self._batch(batch, width)
                widths.add(width)
        return lines, widths

    def _batch(self, batch: list[str], width: int) -> list[str]:
        first = self.numbers[batch[0]]
        numbers = [self.numbers[value] for value in batch]
        kind = vector(width)
        lines = []
        packed = "poison"
        if width == 1:
            packed = batch[0]
        else:
            for lane, value in enumerate(batch):
                new = f"%pack{first}.{lane}"
                lines.append(f"{new} = insertelement {kind} {packed}, double {value}, i32 {lane}")
                packed = new
        lines.append(
            f"%both{first} = call {{{kind}, {kind}}} @pinred.sincos{width}({kind} {packed})"
        )
        for part, letter in enumerate("sc"):
            whole = f"%{letter}{numbers[0]}" if width == 1 else f"%all{letter}{first}"
            lines.append(f"{whole} = extractvalue {{{kind}, {kind}}} %both{first}, {part}")
            if width > 1:
                lines += [
                    f"%{letter}{n} = extractelement {kind} {whole}, i32 {lane}"
                    for lane, n in enumerate(numbers)
                ]
        return lines


class _Lowering:
    """The IR of one Function, instruction by instruction.

    Values are names of SSA values, or constants.  Every one has a width (1, or a number of
    lanes) and a stage in which it is known; constants are known in every one.
    """

    def __init__(self, marks: Sequence[Mark]) -> None:
        self.writer = _Writer()
        self.width: dict[str, int] = {}  # of what has more than one lane
        self.stage: dict[str, int] = {}  # of what is not known in stage 0
        self.used: set[int] = set()  # operations
        self.both: dict[str, int] = {}  # numbers of the angles with lanes
        self._same: dict[tuple[str, int], str] = {}  # one number in all lanes
        self._sums: set[int] = set()  # widths
        self._marks = marks
        self._operands: list[str] = []  # of the next mark
        self._marked: list[str] = []  # values of the marks so far

    def put(self, new: str, width: int, text: str, *operands: str) -> str:
        """Write down `new`, as soon as its operands are known."""
        at = max([self.stage.get(v, 0) for v in operands], default=0)
        self.writer.stages[at].append(f"{new} = {text}")
        return self._known(new, width, at)

    def operation(self, new: str, op: int, template: str, operands: list[str]) -> str:
        """Write down an operation: on lanes, if one of its operands has lanes."""
        self.used.add(op)
        width = max([self.width.get(v, 1) for v in operands])
        one = constant(1.0)
        if width > 1:
            operands = [self.in_lanes(v, width) for v in operands]
            if op not in _LINES:
                return self._one_by_one(new, template, operands, width)
            one = f"splat (double {one})"
        return self.put(new, width, template.format(*operands, T=vector(width), one=one), *operands)

    def _one_by_one(self, new: str, template: str, operands: list[str], width: int) -> str:
        """Write down an operation that has no form in lanes, one lane after another."""
        packed, T = "poison", vector(width)
        for lane in range(width):
            numbers = [
                self.put(f"{new}.{lane}.{k}", 1, f"extractelement {T} {v}, i32 {lane}", v)
                for k, v in enumerate(operands)
            ]
            value = self.put(f"{new}.{lane}", 1, template.format(*numbers), *numbers)
            text = f"insertelement {T} {packed}, double {value}, i32 {lane}"
            packed = self.put(f"{new}.to{lane}", width, text, value, packed)
        return packed

    def angle(self, letter: str, angle: str) -> str:
        """Return the name of the sine (s) or cosine (c) of an angle."""
        width = self.width.get(angle, 1)
        if width > 1:
            if angle not in self.both:
                T = vector(width)
                self.both[angle] = k = len(self.both)
                text = f"call {{{T}, {T}}} @pinred.sincos{width}({T} {angle})"
                both = self.put(f"%wide{k}", 1, text, angle)
                for part, name in enumerate("sc"):
                    text = f"extractvalue {{{T}, {T}}} {both}, {part}"
                    self.put(f"%wide{name}{k}", width, text, both)
            return f"%wide{letter}{self.both[angle]}"
        at = self.stage.get(angle, 0)
        return self._known(f"%{letter}{self.writer.angle(angle, at)}", 1, at + 1)

    def operand(self, value: str) -> None:
        """Take the next operand of the marks; with its last one a mark gets its value."""
        mark = self._marks[len(self._marked)]
        self._operands.append(value)
        if len(self._operands) == len(mark.operands):
            self._marked.append(self._value(mark, f"%mark{len(self._marked)}", self._operands))
            self._operands = []

    def marked(self, k: int) -> str:
        """Return the value of a mark."""
        return self._marked[k]

    def declarations(self, angles: set[int]) -> list[str]:
        """Return what the lines need besides sines and cosines, of so many angles at once."""
        calls = {_CALLS[op] for op in self.used & _CALLS.keys()}
        if 1 in angles:  # one angle by itself: its code declares these two
            calls -= {_CALLS[ca.OP_FABS], _CALLS[ca.OP_COPYSIGN]}
        return [
            *(_declaration(*call) for call in sorted(calls)),
            *(_helper(op) for op in sorted(self.used & _BODIES.keys())),
            *(f"declare double @{_sum(w)}(double, {vector(w)})" for w in sorted(self._sums)),
        ]

    def _known(self, new: str, width: int, at: int) -> str:
        if width > 1:
            self.width[new] = width
        if at:
            self.stage[new] = at
        return new

    def _value(self, mark: Mark, new: str, operands: list[str]) -> str:
        T = vector(mark.width)
        if mark.kind == "pack":
            return self._packed(new, operands)
        (packed,) = operands
        packed = self.in_lanes(packed, mark.width)
        if mark.kind == "lane":
            return self.put(new, 1, f"extractelement {T} {packed}, i32 {mark.lane}", packed)
        self._sums.add(mark.width)
        zero = constant(-0.0)
        call = f"call {_FLAGS} double @{_sum(mark.width)}(double {zero}, {T} {packed})"
        return self.put(new, 1, call, packed)

    def _packed(self, new: str, operands: list[str]) -> str:
        """Return a value with one operand per lane, the constant ones to begin with."""
        width = len(operands)
        lanes = [v if _is_constant(v) else "poison" for v in operands]
        packed = f"<{', '.join(f'double {v}' for v in lanes)}>"
        self.width[packed] = width
        for lane, value in enumerate(operands):
            if not _is_constant(value):
                text = f"insertelement {vector(width)} {packed}, double {value}, i32 {lane}"
                packed = self.put(f"{new}.{lane}", width, text, packed, value)
        return packed

    def in_lanes(self, value: str, width: int) -> str:
        """Return a value in lanes, the same number in all if it is one."""
        if self.width.get(value, 1) == width:
            return value
        if _is_constant(value):
            return f"splat (double {value})"
        if (value, width) not in self._same:
            T, new = vector(width), f"%same{len(self._same)}"
            first = self.put(
                f"{new}.0", width, f"insertelement {T} poison, double {value}, i32 0", value
            )
            self._same[value, width] = self.put(
                new,
                width,
                f"shufflevector {T} {first}, {T} poison, {vector(width, 'i32')} zeroinitializer",
                first,
            )
        return self._same[value, width]


def lower(
    function: ca.Function,
    name: str,
    marks: Sequence[Mark] | None = None,
    *,
    fma: bool,
    wide: int = 1,
    wide_inputs: Sequence[int] = (0,),
) -> str:
    """Return the IR of a Function.

    marks: of a Function made by `Lanes`, whose last input and first output are their symbols
    and their operands.  wide: how many values the wide inputs and the output have of every
    number, in lanes: the function is evaluated at so many places at once.  fma: whether the
    CPU has a fused multiply-add.

    Raises UnsupportedOperationError if it holds an operation that has no machine code.
    """
    low = _Lowering(marks or ())
    value: dict[int, str] = {}  # of every register, as of the current instruction
    loads: dict[tuple[int, int], str] = {}
    templates = _templates()
    inputs = function.n_in() if marks is None else function.n_in() - 1
    for k in range(function.n_instructions()):
        op, arguments = function.instruction_id(k), function.instruction_input(k)
        template = templates.get(op)
        if template is not None:
            new = low.operation(f"%r{k}", op, template, [value[i] for i in arguments])
        elif op == ca.OP_CONST:
            new = constant(function.instruction_constant(k))
        elif op == ca.OP_INPUT:
            which, entry = arguments
            if which == inputs:
                new = low.marked(entry)
            elif (which, entry) in loads:
                new = loads[which, entry]
            else:
                lanes = wide if which in wide_inputs else 1
                at = f"getelementptr double, ptr %in{which}, i64 {lanes * entry}"
                low.put(f"%p{k}", 1, at)
                new = low.put(f"%r{k}", lanes, f"load {vector(lanes)}, ptr %p{k}, align 8")
                loads[which, entry] = new
        elif op == ca.OP_OUTPUT:
            source, (which, entry) = value[arguments[0]], function.instruction_output(k)
            if marks is not None and which == 0:
                low.operand(source)
            else:
                source = source if wide == 1 else low.in_lanes(source, wide)
                low.writer.stages[low.stage.get(source, 0)] += [
                    f"%p{k} = getelementptr double, ptr %out, i64 {wide * entry}",
                    f"store {vector(wide)} {source}, ptr %p{k}, align 8",
                ]
            continue
        elif op in (ca.OP_SIN, ca.OP_COS):
            new = low.angle("s" if op == ca.OP_SIN else "c", value[arguments[0]])
        elif op == ca.OP_ASSIGN:
            new = value[arguments[0]]
        else:
            raise UnsupportedOperationError(
                f"'{name}' holds the operation '{_NAMES.get(op, op)}' (instruction {k}), which "
                "cannot be compiled; write the expression without it"
            )
        value[function.instruction_output(k)[0]] = new
    lines, widths = low.writer.body()
    widths |= {low.width[angle] for angle in low.both}
    pointers = [f"ptr noalias readonly %in{k}" for k in range(inputs)]
    return "\n".join(
        [
            *low.declarations(widths),
            *(sincos_ir(width, fma=fma) for width in sorted(widths)),
            *_LIBM_SINCOS,
            _UNLIKELY,
            f"define void @{name}({', '.join([*pointers, 'ptr noalias %out'])}) nounwind {{",
            *lines,
            "ret void",
            "}",
        ]
    )


def _is_constant(value: str) -> bool:
    return value[0] != "%"


def _sum(width: int) -> str:
    return f"llvm.vector.reduce.fadd.v{width}f64"


@cache
def _templates() -> dict[int, str]:
    """Return the line of every operation that gives one value."""
    calls = {op: (f"@{name}", count) for op, (name, count) in _CALLS.items()}
    calls |= {op: (f"@pinred.{_NAMES[op]}", 1 if op in _UNARY else 2) for op in _BODIES}
    return _LINES | {
        op: f"call double {name}({', '.join(['double {}'] * count)})"
        for op, (name, count) in calls.items()
    }


def _declaration(name: str, count: int) -> str:
    return f"declare double @{name}({', '.join(['double'] * count)}) {_PURE}"


def _helper(op: int) -> str:
    arguments = "double %a" if op in _UNARY else "double %a, double %b"
    body = "\n".join(_BODIES[op])
    return (
        f"define internal double @pinred.{_NAMES[op]}({arguments}) alwaysinline {{\n"
        f"{body}\nret double %r\n}}"
    )
