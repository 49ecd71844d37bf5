"""CasADi Function → LLVM IR → machine code → address.  No C compiler.

The instructions of a Function are written down as LLVM IR, one line each: registers become
SSA values, so nothing is kept on a stack.  Sine and cosine are the one thing that libm is
too slow for: they are gathered into batches of angles that are known at the same time, and
each batch is one vector computation of both.

The floating-point flags are `contract` and `reassoc`, and `arcp` in divisions: two quotients
of one divisor may become products with 1/y, which differs where 1/y overflows (|y| < 6e-309).
Not `nnan` or `ninf`, and not `nsz` either: together with `reassoc` it turns (x + y) − x into
y, and a NaN in x is gone.

Of LLVM's passes only the inlining of helpers runs.  Code generation finds common
subexpressions by itself; the usual pipeline takes a third longer and gives no faster code.
"""

from __future__ import annotations

import ctypes.util
import platform
from dataclasses import dataclass, field
from functools import cache
from threading import Lock
from typing import Any

import casadi as ca
import llvmlite.binding as llvm

from ..errors import InputError, UnsupportedOperationError
from .sincos import LANES, constant, sincos_ir, vector

_FLAGS = "contract reassoc"
_NAMES = {getattr(ca, key): key[3:].lower() for key in dir(ca) if key.startswith("OP_")}

# One line of IR each; {} are the operands.
_LINES = {
    ca.OP_ADD: f"fadd {_FLAGS} double {{}}, {{}}",
    ca.OP_SUB: f"fsub {_FLAGS} double {{}}, {{}}",
    ca.OP_MUL: f"fmul {_FLAGS} double {{}}, {{}}",
    ca.OP_DIV: f"fdiv {_FLAGS} arcp double {{}}, {{}}",
    ca.OP_NEG: f"fneg {_FLAGS} double {{}}",
    ca.OP_SQ: f"fmul {_FLAGS} double {{0}}, {{0}}",
    ca.OP_TWICE: f"fadd {_FLAGS} double {{0}}, {{0}}",
    ca.OP_INV: f"fdiv {_FLAGS} arcp double 1.0, {{}}",
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
_RESERVED = {name for name, _ in _CALLS.values()} | {"sin", "cos", "sincos"}

_IDENTITY = 16  # bytes: format, word size and byte order

_LOCK = Lock()


@dataclass(frozen=True, eq=False)
class NativeCode:
    """A function in memory, callable as long as this object is alive.

    address: of `void name(const double *in0, …, double *out)`.
    """

    name: str
    address: int
    _engine: Any = field(repr=False)


def compile_object(function: ca.Function, name: str) -> bytes:
    """Return object code of `void name(const double *in0, …, double *out)` for this CPU.

    function: an SX Function of any number of dense columns with one dense column as its
    output.  No pointer may overlap `out`; one to an empty column may be anything.

    Raises InputError if the function is not such, or `name` not the name of a function, and
    UnsupportedOperationError if it holds an operation that has no machine code.
    """
    _check(function, name)
    text = _lower(function, name)
    with _LOCK:
        context = llvm.create_context()
        module = llvm.parse_assembly(text, context)
        machine = _machine()
        passes = llvm.create_new_module_pass_manager()
        passes.add_always_inliner_pass()
        passes.run(module, llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options()))
        code: bytes = machine.emit_object(module)
        module.close()  # before its context, which it does not keep alive
    return code


def load_object(code: bytes, name: str) -> NativeCode:
    """Put object code of `compile_object` into memory.

    The same code may be loaded any number of times, by any thread.  Code from elsewhere can
    do anything: only load what was compiled here, or comes from an ObjectCache.

    Raises InputError if it does not begin as object code does or has no function `name`.
    """
    with _LOCK:
        if code[:_IDENTITY] != _identity():
            raise InputError(f"{len(code)} bytes for '{name}' are no object code of this machine")
        machine = _machine()
        # The global context: one of its own would have to outlive the engine.
        engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
        engine.add_object_file(llvm.ObjectFileRef.from_data(code))
        engine.finalize_object()
        address = engine.get_function_address(name)
    if not address:
        raise InputError(f"the object code has no function '{name}'")
    return NativeCode(name, address, engine)


@cache
def _target() -> llvm.Target:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    if not llvm.address_of_symbol("remainder"):
        llvm.load_library_permanently(ctypes.util.find_library("m") or "libm.so.6")
    return llvm.Target.from_default_triple()


def _machine() -> llvm.TargetMachine:
    """Return a target for this CPU.  Needed anew each time: MCJIT takes it over.

    The code model is the one for code that may land far from its constants and from libm.
    """
    return _target().create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=llvm.get_host_cpu_features().flatten(),
        opt=2,
        jit=True,
    )


@cache
def _identity() -> bytes:
    """Return how every object file of this machine begins; LLVM dies of anything else."""
    begin: bytes = _machine().emit_object(llvm.parse_assembly(""))
    return begin[:_IDENTITY]


@cache
def _has_fma() -> bool:
    """Return whether the CPU multiplies and adds in one instruction."""
    aarch64 = platform.machine().lower() in {"arm64", "aarch64"}
    return aarch64 or bool(llvm.get_host_cpu_features().get("fma"))


def _check(function: ca.Function, name: str) -> None:
    if not (name.isascii() and name.isidentifier()) or name in _RESERVED:
        raise InputError(f"the function must have a name that is free in C, got {name!r}")
    if not function.is_a("SXFunction"):
        raise InputError(
            f"'{name}' must be a Function of SX expressions, got {function.class_name()}; "
            "expand() makes one of an MX Function"
        )
    if function.n_out() != 1:
        raise InputError(f"'{name}' must have one output, got {function.n_out()}")
    for what, shape in [
        *((f"input {k}", function.sparsity_in(k)) for k in range(function.n_in())),
        ("the output", function.sparsity_out(0)),
    ]:
        if not (shape.is_dense() and (shape.is_column() or shape.numel() == 0)):
            raise InputError(f"{what} of '{name}' must be a dense column, got {shape.dim(True)}")


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
        """Return all lines, and how many angles at once were asked for."""
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


def _lower(function: ca.Function, name: str) -> str:
    """Return the IR of a Function."""
    writer = _Writer()
    value: dict[int, str] = {}  # of every register, as of the current instruction
    stage: dict[str, int] = {}  # in which it is known; constants are known in every one
    loads: dict[tuple[int, int], str] = {}
    used: set[int] = set()
    templates = _templates()
    opcode, inputs = function.instruction_id, function.instruction_input
    outputs = function.instruction_output
    for k in range(function.n_instructions()):
        op = opcode(k)
        template = templates.get(op)
        if template is not None:
            operands = [value[i] for i in inputs(k)]
            at = max([stage.get(v, 0) for v in operands])
            new = f"%r{k}"
            writer.stages[at].append(f"{new} = {template.format(*operands)}")
            used.add(op)
        elif op == ca.OP_CONST:
            new, at = constant(function.instruction_constant(k)), 0
        elif op == ca.OP_INPUT:
            which, entry = inputs(k)
            at = 0
            new = loads.setdefault((which, entry), f"%r{k}")
            if new == f"%r{k}":
                writer.stages[0] += [
                    f"%p{k} = getelementptr double, ptr %in{which}, i64 {entry}",
                    f"{new} = load double, ptr %p{k}, align 8",
                ]
        elif op == ca.OP_OUTPUT:
            source, (_, entry) = value[inputs(k)[0]], outputs(k)
            writer.stages[stage.get(source, 0)] += [
                f"%p{k} = getelementptr double, ptr %out, i64 {entry}",
                f"store double {source}, ptr %p{k}, align 8",
            ]
            continue
        elif op in (ca.OP_SIN, ca.OP_COS):
            angle = value[inputs(k)[0]]
            at = stage.get(angle, 0)
            new = f"%{'s' if op == ca.OP_SIN else 'c'}{writer.angle(angle, at)}"
            at += 1
        elif op == ca.OP_ASSIGN:
            new = value[inputs(k)[0]]
            at = stage.get(new, 0)
        else:
            raise UnsupportedOperationError(
                f"'{name}' holds the operation '{_NAMES.get(op, op)}' (instruction {k}), which "
                "cannot be compiled; write the expression without it"
            )
        value[outputs(k)[0]] = new
        if at:
            stage[new] = at
    lines, widths = writer.body()
    pointers = [f"ptr noalias readonly %in{k}" for k in range(function.n_in())]
    signature = ", ".join([*pointers, "ptr noalias %out"])
    calls = {_CALLS[op] for op in used & _CALLS.keys()}
    if 1 in widths:  # one angle by itself: its code declares these two
        calls -= {_CALLS[ca.OP_FABS], _CALLS[ca.OP_COPYSIGN]}
    return "\n".join(
        [
            *(_declaration(*call) for call in sorted(calls)),
            *(_helper(op) for op in sorted(used & _BODIES.keys())),
            *(sincos_ir(width, fma=_has_fma()) for width in sorted(widths)),
            *_LIBM_SINCOS,
            _UNLIKELY,
            f"define void @{name}({signature}) nounwind {{",
            *lines,
            "ret void",
            "}",
        ]
    )


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
