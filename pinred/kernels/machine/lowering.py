"""Translation of CasADi Functions to LLVM IR.

Each instruction becomes one line of IR.  Registers become SSA values, so no stack is needed.
Operations on values in lanes become vector instructions.  Calls of libm for
sine and cosine are too slow.  Therefore angles that are available at the same time form a batch,
and one vector computation evaluates both functions of a batch.

The floating-point flags are `contract` and `reassoc`, and `arcp` in divisions.  With `arcp`, two
quotients of one divisor may become products with 1/y, which differs where 1/y overflows
(|y| < 6e-309).  `nnan` and `ninf` are not set, so that NaN stays visible.  `nsz` is not set
either: together with `reassoc` it turns (x + y) − x into y, which hides a NaN in x.

LLVM IR of CasADi's scalar operations: single lines, calls, and helper functions.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import cache
from itertools import chain, pairwise

import casadi as ca

from ...common.errors import UnsupportedOperationError
from ...reduction.tree.identical_branches import Mark
from .sincos import LANES, constant, sincos_ir, vector

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


_LIBM_SINCOS = [f"declare double @{name}(double) {PURE}" for name in ("sin", "cos")]
_ONE = constant(1.0)
_UNLIKELY = '!0 = !{!"branch_weights", i32 100000, i32 1}'
_VALUE = re.compile(r"%[\w.]+")
_DEFERRED = ("getelementptr", "load", "insertelement", "shufflevector")
# Without alignment, half of the vectors that are spilled to the stack cross a cache line.
_ATTRIBUTES = "nounwind alignstack(64)"
_OPERATION = f" {FLAGS} "  # lines of arithmetic contain it


class _Writer:
    """The lines of IR of one function, grouped into stages.

    Stage 0 needs no sine or cosine.  After each stage, the sines and cosines of its values are
    computed for use in the next stage.  Most kernels have two stages.

    Attributes:
        stages: Lines of each stage.
        angles: Arguments of the sines and cosines of each stage.
        numbers: Index of each angle in the order of registration.
    """

    def __init__(self) -> None:
        self.stages: list[list[str]] = [[]]
        self.angles: list[list[str]] = [[]]
        self.numbers: dict[str, int] = {}

    def angle(self, value: str, stage: int) -> int:
        """Register an angle for the sines and cosines of a stage.

        Args:
            value: Name of the angle.
            stage: Stage in which the angle is available.
        Returns:
            Index of the angle.
        """
        if value not in self.numbers:
            self.numbers[value] = len(self.numbers)
            self.angles[stage].append(value)
            if stage + 1 == len(self.stages):
                self.stages.append([])
                self.angles.append([])
        return self.numbers[value]

    def body(self) -> tuple[list[str], set[int]]:
        """Return all lines of IR, and the set of batch sizes that occur."""
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
        T = vector(width)
        lines = []
        packed = "poison"
        if width == 1:
            packed = batch[0]
        else:
            for lane, value in enumerate(batch):
                new = f"%pack{first}.{lane}"
                lines.append(f"{new} = insertelement {T} {packed}, double {value}, i32 {lane}")
                packed = new
        lines.append(f"%both{first} = call {{{T}, {T}}} @pinred.sincos{width}({T} {packed})")
        for index, letter in enumerate("sc"):
            values = f"%{letter}{numbers[0]}" if width == 1 else f"%all{letter}{first}"
            lines.append(f"{values} = extractvalue {{{T}, {T}}} %both{first}, {index}")
            if width > 1:
                lines += [
                    f"%{letter}{n} = extractelement {T} {values}, i32 {lane}"
                    for lane, n in enumerate(numbers)
                ]
        return lines


class _Lowering:
    """The translation of one Function to IR, instruction by instruction.

    A value is the name of an SSA value, or a constant.  Each value has a width (the number of
    lanes) and the first stage in which it is available.  Constants are available in all stages.

    Attributes:
        writer: The lines of IR written so far.
        width: Width of each value that has more than one lane.
        stage: First stage of each value that is not available in stage 0.
        used: CasADi operations that occur in the Function.
        both: Indices of the angles with lanes.
    """

    def __init__(self, marks: Sequence[Mark]) -> None:
        self.writer = _Writer()
        self.width: dict[str, int] = {}
        self.stage: dict[str, int] = {}
        self.used: set[int] = set()
        self.both: dict[str, int] = {}
        self._copies: dict[tuple[str, int], str] = {}  # (scalar, width) → the scalar in all lanes
        self._sums: set[int] = set()  # widths of the sums over lanes in the Function
        self._marks = marks
        self._operands: list[str] = []  # operands of the next Mark that were already read
        self._marked: list[str] = []  # names of the results of all completed Marks

    def put(self, new: str, width: int, text: str, *operands: str) -> str:
        """Emit a line of IR in the first stage in which all its operands are available.

        Args:
            new: Name of the value.
            width: Number of lanes.
            text: Right-hand side of the line of IR.
            operands: Names of the operands.
        Returns:
            Name of the value.
        """
        at = 0
        for value in operands:  # a kernel has thousands of lines
            at = max(at, self.stage.get(value, 0))
        self.writer.stages[at].append(f"{new} = {text}")
        return self._register(new, width, at)

    def operation(self, new: str, op: int, template: str, operands: list[str]) -> str:
        """Emit an operation, in lanes if one of its operands has lanes.

        Args:
            new: Name of the value.
            op: CasADi's operation.
            template: Line of IR of the operation, with placeholders.
            operands: Names of the operands.
        Returns:
            Name of the value.
        """
        self.used.add(op)
        width = max(self.width.get(v, 1) for v in operands) if self.width else 1
        if width == 1:
            return self.put(new, 1, template.format(*operands, T="double", one=_ONE), *operands)
        operands = [self.in_lanes(v, width) for v in operands]
        if op not in LINES:
            return self._operate_per_lane(new, template, operands, width)
        text = template.format(*operands, T=vector(width), one=f"splat (double {_ONE})")
        return self.put(new, width, text, *operands)

    def _operate_per_lane(self, new: str, template: str, operands: list[str], width: int) -> str:
        """Emit an operation without a vector form in LLVM, one lane after another."""
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
                for index, name in enumerate("sc"):
                    text = f"extractvalue {{{T}, {T}}} {both}, {index}"
                    self.put(f"%wide{name}{k}", width, text, both)
            return f"%wide{letter}{self.both[angle]}"
        at = self.stage.get(angle, 0)
        return self._register(f"%{letter}{self.writer.angle(angle, at)}", 1, at + 1)

    def operand(self, value: str) -> None:
        """Add the next operand of a Mark; the last operand of a Mark completes its result."""
        mark = self._marks[len(self._marked)]
        self._operands.append(value)
        if len(self._operands) == len(mark.operands):
            self._marked.append(self._value(mark, f"%mark{len(self._marked)}", self._operands))
            self._operands = []

    def marked(self, k: int) -> str:
        """Return the name of the result of the k-th Mark."""
        return self._marked[k]

    def declarations(self, angles: set[int]) -> list[str]:
        """Return the declarations of called functions; angles: batch sizes that occur."""
        calls = {CALLS[op] for op in self.used & CALLS.keys()}
        if 1 in angles:  # the code for a batch of one angle declares sine and cosine
            calls -= {CALLS[ca.OP_FABS], CALLS[ca.OP_COPYSIGN]}
        return [
            *(declaration(*call) for call in sorted(calls)),
            *(helper(op) for op in sorted(self.used & BODIES.keys())),
            *(f"declare double @{_sum(w)}(double, {vector(w)})" for w in sorted(self._sums)),
        ]

    def _register(self, new: str, width: int, at: int) -> str:
        if width > 1:
            self.width[new] = width
        if at:
            self.stage[new] = at
        return new

    def _value(self, mark: Mark, new: str, operands: list[str]) -> str:
        T = vector(mark.width)
        if mark.kind == "pack":
            return self._pack(new, operands)
        (packed,) = operands
        packed = self.in_lanes(packed, mark.width)
        if mark.kind == "lane":
            return self.put(new, 1, f"extractelement {T} {packed}, i32 {mark.lane}", packed)
        self._sums.add(mark.width)
        zero = constant(-0.0)
        call = f"call {FLAGS} double @{_sum(mark.width)}(double {zero}, {T} {packed})"
        return self.put(new, 1, call, packed)

    def _pack(self, new: str, operands: list[str]) -> str:
        """Pack one operand into each lane, constants first; return the name of the vector."""
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
        """Return a value as a vector; a scalar is copied to all lanes."""
        if self.width.get(value, 1) == width:
            return value
        if _is_constant(value):
            return f"splat (double {value})"
        if (value, width) not in self._copies:
            T, new = vector(width), f"%same{len(self._copies)}"
            first = self.put(
                f"{new}.0", width, f"insertelement {T} poison, double {value}, i32 0", value
            )
            self._copies[value, width] = self.put(
                new,
                width,
                f"shufflevector {T} {first}, {T} poison, {vector(width, 'i32')} zeroinitializer",
                first,
            )
        return self._copies[value, width]


def lower(
    function: ca.Function,
    name: str,
    marks: Sequence[Mark] | None = None,
    *,
    fma: bool,
    wide: int = 1,
    wide_inputs: Sequence[int] = (0,),
    part: int = 0,
) -> str:
    """Translate a Function to LLVM IR.

    Args:
        function: The Function.
        name: Name of the compiled function.
        marks: Marks of a Function built by `Lanes`.  The last input of such a Function contains
            the symbols of the marks, and its first output their operands.
        fma: Whether the CPU has a fused multiply-add.
        wide: Number of points at which the function is evaluated at once.  Each entry of the
            wide inputs and of the output then has this many lanes.
        wide_inputs: Indices of the inputs with lanes.
        part: Number of lines of IR in each function that the code is divided into, see `_divide`;
            0 for code in one function.
    Returns:
        The IR.
    Raises:
        UnsupportedOperationError: The Function contains an operation without machine code.
    """
    low = _Lowering(marks or ())
    value: dict[int, str] = {}  # value currently stored in each register
    loads: dict[tuple[int, int], str] = {}
    lines_of = templates()
    inputs = function.n_in() if marks is None else function.n_in() - 1
    for k in range(function.n_instructions()):
        op, arguments = function.instruction_id(k), function.instruction_input(k)
        template = lines_of.get(op)
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
                f"'{name}' contains the operation '{NAMES.get(op, op)}' (instruction {k}), which "
                "cannot be compiled; write the expression without it"
            )
        value[function.instruction_output(k)[0]] = new
    lines, widths = low.writer.body()
    lines = _defer(lines)
    widths |= {low.width[angle] for angle in low.both}
    pointers = [*(f"ptr noalias readonly %in{k}" for k in range(inputs)), "ptr noalias %out"]
    parts, lines = _divide(lines, part, low.width, name, pointers) if part else ([], lines)
    return "\n".join(
        [
            *low.declarations(widths),
            *(sincos_ir(width, fma=fma) for width in sorted(widths)),
            *_LIBM_SINCOS,
            _UNLIKELY,
            *parts,
            f"define void @{name}({', '.join(pointers)}) {_ATTRIBUTES} {{",
            *lines,
            "ret void",
            "}",
        ]
    )


def _defer(lines: list[str]) -> list[str]:
    """Move loads and packs of numbers to their first uses, so that fewer numbers are alive.

    LLVM does not move them across the branches of sines and cosines, but stores them until then.

    Args:
        lines: Lines of IR without branches.
    Returns:
        The lines in their new order.
    """
    deferred, ordered = dict[str, str](), list[str]()

    def emit(line: str) -> None:
        for value in _VALUE.findall(line):
            if value in deferred:
                emit(deferred.pop(value))
        ordered.append(line)

    for line in lines:
        name, _, operation = line.partition(" = ")
        if operation.startswith(_DEFERRED):
            deferred[name] = line
        else:
            emit(line)
    return ordered


def _divide(
    lines: list[str], part: int, widths: Mapping[str, int], name: str, pointers: list[str]
) -> tuple[list[str], list[str]]:
    """Divide long code into functions, because the time of LLVM grows faster than their length.

    The functions pass values to later ones in an array.  A part starts at an arithmetic operation,
    so that these values are numbers and vectors, but not addresses or results of sincos.

    Args:
        lines: Lines of IR without branches.
        part: Number of lines in a part; parts may be a few lines longer.
        widths: Number of lanes of each value that has more than one.
        name: Name of the function.
        pointers: Its parameters.
    Returns:
        The functions, and the lines that call them.
    """
    starts = [0]
    for k, line in enumerate(lines):
        if k >= starts[-1] + part and _OPERATION in line:
            starts.append(k)
    parts = [
        [(line, _VALUE.findall(line)) for line in lines[start:stop]]
        for start, stop in pairwise([*starts, len(lines)])
    ]
    made = {  # the part that computes each value
        values[0]: k for k, code in enumerate(parts) for line, values in code if line[0] == "%"
    }
    indices: dict[str, int] = {}  # in the array, of values that later parts need
    size = 0
    for k, code in enumerate(parts):
        for value in chain.from_iterable(values for _, values in code):
            if made.get(value, k) < k and value not in indices:
                indices[value] = size
                size += widths.get(value, 1)

    def access(value: str) -> tuple[str, str, str]:
        """Return the name and the line of the address of a value in the array, and its type."""
        at = f"%at.{value[1:]}"
        line = f"{at} = getelementptr double, ptr %work, i64 {indices[value]}"
        return at, line, vector(widths.get(value, 1))

    functions: list[str] = []
    parameters = ", ".join([*pointers, "ptr noalias %work"])
    for k, code in enumerate(parts):
        functions.append(
            f"define internal void @{name}.{k}({parameters}) noinline {_ATTRIBUTES} {{"
        )
        loaded = set()
        for line, values in code:
            for value in values:
                if made.get(value, k) < k and value not in loaded:
                    loaded.add(value)
                    at, address, T = access(value)
                    load = f"{value} = load {T}, ptr {at}, align 8, !invariant.load !1"
                    functions += [address, load]
            functions.append(line)
            if line[0] == "%" and values[0] in indices:
                at, address, T = access(values[0])
                functions += [address, f"store {T} {values[0]}, ptr {at}, align 8"]
        functions += ["ret void", "}"]
    arguments = ", ".join(f"ptr {pointer.split()[-1]}" for pointer in [*pointers, "%work"])
    calls = [f"call void @{name}.{k}({arguments})" for k in range(len(parts))]
    return [*functions, "!1 = !{}"], [f"%work = alloca [{size} x double]", *calls]


def _is_constant(value: str) -> bool:
    return value[0] != "%"


def _sum(width: int) -> str:
    return f"llvm.vector.reduce.fadd.v{width}f64"
