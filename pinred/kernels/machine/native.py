"""Compilation of CasADi Functions to machine code with LLVM, without a C compiler.

The only LLVM pass is the inlining of helpers.  Code generation eliminates common
subexpressions; LLVM's default pipeline takes a third longer, and its code is not faster.
"""

from __future__ import annotations

import ctypes.util
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from threading import Lock
from typing import Any, NoReturn

import casadi as ca
import llvmlite.binding as llvm

from ...common.cpu_target import cpu_target
from ...common.errors import InputError, NotCopyable
from ...reduction.tree.identical_branches import Mark
from .lowering import lower
from .operations import RESERVED

_IDENTITY = 16  # number of bytes that encode format, word size and byte order

_LOCK = Lock()


@dataclass(frozen=True, eq=False)
class NativeCode:
    """A function in memory, callable as long as this object exists.

    Attributes:
        name: Name of the function.
        address: Address of `void name(const double *in0, …, double *out)`.
    """

    name: str
    address: int
    _engine: Any = field(repr=False)

    def __reduce__(self) -> NoReturn:
        # Copies of llvmlite objects are incomplete and print errors when they are deleted.
        raise NotCopyable(
            f"the machine code '{self.name}' lives in this process and can be neither copied nor "
            "pickled; create it in the other process by load(…) or simulate(…), or pass results by "
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
    """Compile `void name(const double *in0, …, double *out)` for the CPU of `cpu_target`.

    No pointer may overlap `out`; the pointer of an empty column may have any value.

    Args:
        function: SX Function of dense columns with one dense column as output.
        name: Name of the compiled function, a C identifier.
        marks: Marks of a Function built by `Lanes`; its additional input and output have no
            pointers.
        wide: Number of points at which the function is evaluated at once.  Each entry of the
            wide inputs and of `out` then occupies this many consecutive numbers.
        wide_inputs: Indices of the inputs with this layout.
    Returns:
        The object code.
    Raises:
        InputError: The Function or the name is invalid.
        UnsupportedOperationError: The Function contains an operation without machine code.
    """
    _check(function, name, outputs=1 if marks is None else 2)
    text = lower(function, name, marks, fma=cpu_target().fma, wide=wide, wide_inputs=wide_inputs)
    with _LOCK:
        context = llvm.create_context()
        module = llvm.parse_assembly(text, context)
        machine = _create_machine()
        passes = llvm.create_new_module_pass_manager()
        passes.add_always_inliner_pass()
        passes.run(module, llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options()))
        code: bytes = machine.emit_object(module)
        module.close()  # before its context is deleted
    return code


def load_object(code: bytes, name: str) -> NativeCode:
    """Load object code created by `compile_object` into memory.

    The same code may be loaded repeatedly, by any thread.  The code runs with all rights of the
    process, so load only code that was compiled here or read from an ObjectCache.

    Args:
        code: The object code.
        name: Name of the function.
    Returns:
        The function.
    Raises:
        InputError: The bytes are not object code for this machine, or the function is missing.
    """
    return load_objects({name: code})[0]


def load_objects(codes: Mapping[str, bytes]) -> tuple[NativeCode, ...]:
    """Load object codes into memory that they share; see `load_object`.

    Args:
        codes: Object code by the name of its function.
    Returns:
        The functions, in order.
    Raises:
        InputError: As for `load_object`.
    """
    for name, code in codes.items():
        if code[:_IDENTITY] != _identity():
            raise InputError(
                f"the {len(code)} bytes for '{name}' are not object code for this machine"
            )
    with _LOCK:
        machine = _create_machine()
        # Use the global context, because a private one would have to outlive the engine.
        engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
        for code in codes.values():
            engine.add_object_file(llvm.ObjectFileRef.from_data(code))
        engine.finalize_object()
        addresses = {name: engine.get_function_address(name) for name in codes}
    for name, address in addresses.items():
        if not address:
            raise InputError(f"the object code has no function '{name}'")
    return tuple(NativeCode(name, address, engine) for name, address in addresses.items())


@cache
def _target() -> llvm.Target:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    if not llvm.address_of_symbol("remainder"):
        llvm.load_library_permanently(ctypes.util.find_library("m") or "libm.so.6")
    return llvm.Target.from_default_triple()


def _create_machine() -> llvm.TargetMachine:
    """Create a target machine for the CPU of `cpu_target`.

    The code model permits code at addresses far from its constants and from libm.

    Returns:
        The machine; MCJIT takes ownership, so each call creates a new one.
    """
    cpu = cpu_target()
    return _target().create_target_machine(
        cpu=cpu.name,
        features=cpu.features,
        opt=1,  # emits code of the same results and speed in a tenth less time than 2
        jit=True,
    )


@cache
def _identity() -> bytes:
    """Return the first bytes of all object files of this machine; others would crash LLVM."""
    header: bytes = _create_machine().emit_object(llvm.parse_assembly(""))
    return header[:_IDENTITY]


def _check(function: ca.Function, name: str, outputs: int) -> None:
    if not (name.isascii() and name.isidentifier()) or name in RESERVED:
        raise InputError(f"the name of the function must be an unused C identifier, got {name!r}")
    if not function.is_a("SXFunction"):
        raise InputError(
            f"'{name}' must be a Function of SX expressions, got {function.class_name()}; "
            "expand() converts an MX Function"
        )
    if function.n_out() != outputs:
        raise InputError(f"'{name}' must have one output, got {function.n_out()}")
    for what, shape in [
        *((f"input {k}", function.sparsity_in(k)) for k in range(function.n_in())),
        ("the output", function.sparsity_out(outputs - 1)),
    ]:
        if not (shape.is_dense() and (shape.is_column() or shape.numel() == 0)):
            raise InputError(f"{what} of '{name}' must be a dense column, got {shape.dim(True)}")
