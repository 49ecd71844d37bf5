"""Native code: from a CasADi Function over LLVM IR to an address, without a C compiler.

Of LLVM's passes only the inlining of helpers runs.  Code generation finds common
subexpressions by itself; the usual pipeline takes a third longer and gives no faster code.
"""

from __future__ import annotations

import ctypes.util
import platform
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from threading import Lock
from typing import Any, NoReturn

import casadi as ca
import llvmlite.binding as llvm

from ...common.errors import InputError, NotCopyable
from ...reduction.tree.limbs import Mark
from .lowering import RESERVED, lower

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

    def __reduce__(self) -> NoReturn:
        # llvmlite's objects let themselves be copied in part, and complain when that part dies.
        raise NotCopyable(
            f"the machine code '{self.name}' lives in this process and can be neither copied nor "
            "pickled; what another process needs is made there: load(…), simulate(…), or "
            "traj.save(…) and read_recording(…)"
        )


def compile_object(
    function: ca.Function,
    name: str,
    marks: Sequence[Mark] | None = None,
    *,
    wide: int = 1,
    wide_inputs: Sequence[int] = (0,),
) -> bytes:
    """Return object code of `void name(const double *in0, …, double *out)` for this CPU.

    function: an SX Function of any number of dense columns with one dense column as its
    output.  No pointer may overlap `out`; one to an empty column may be anything.  marks: of
    a Function made by `Lanes`, whose further inputs and outputs have no pointers.  wide: the
    number of places at which it is evaluated at once; the wide inputs and `out` then hold that
    many values of every number, one after another.

    Raises InputError if the function is not such, or `name` not the name of a function, and
    UnsupportedOperationError if it holds an operation that has no machine code.
    """
    _check(function, name, outputs=1 if marks is None else 2)
    text = lower(function, name, marks, fma=_has_fma(), wide=wide, wide_inputs=wide_inputs)
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
    """Return the first bytes of every object file of this machine; LLVM crashes on others."""
    begin: bytes = _machine().emit_object(llvm.parse_assembly(""))
    return begin[:_IDENTITY]


@cache
def _has_fma() -> bool:
    """Return whether the CPU multiplies and adds in one instruction."""
    aarch64 = platform.machine().lower() in {"arm64", "aarch64"}
    return aarch64 or bool(llvm.get_host_cpu_features().get("fma"))


def _check(function: ca.Function, name: str, outputs: int) -> None:
    if not (name.isascii() and name.isidentifier()) or name in RESERVED:
        raise InputError(f"the function must have a name that is free in C, got {name!r}")
    if not function.is_a("SXFunction"):
        raise InputError(
            f"'{name}' must be a Function of SX expressions, got {function.class_name()}; "
            "expand() makes one of an MX Function"
        )
    if function.n_out() != outputs:
        raise InputError(f"'{name}' must have one output, got {function.n_out()}")
    for what, shape in [
        *((f"input {k}", function.sparsity_in(k)) for k in range(function.n_in())),
        ("the output", function.sparsity_out(outputs - 1)),
    ]:
        if not (shape.is_dense() and (shape.is_column() or shape.numel() == 0)):
            raise InputError(f"{what} of '{name}' must be a dense column, got {shape.dim(True)}")
