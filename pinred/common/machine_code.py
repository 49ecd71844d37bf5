"""Machine code in memory: LLVM's target machine, and object code that is loaded from bytes."""

from __future__ import annotations

import ctypes.util
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from threading import Lock
from typing import Any, NoReturn

import llvmlite.binding as llvm

from .cpu_target import cpu_target
from .errors import InputError, NotCopyable

_IDENTITY = 16  # number of bytes that encode format, word size and byte order

LLVM_LOCK = Lock()  # LLVM's contexts and engines are used by one thread at a time


@dataclass(frozen=True, eq=False)
class NativeCode:
    """A function in memory, callable as long as this object exists.

    Attributes:
        name: Name of the function.
        address: Address of the function, such as `void name(const double *in0, …, double *out)`.
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


def load_object(code: bytes, name: str) -> NativeCode:
    """Load object code for this machine into memory.

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
    with LLVM_LOCK:
        machine = create_machine(1)
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


def create_machine(level: int) -> llvm.TargetMachine:
    """Create a target machine for the CPU of `cpu_target`.

    The code model permits code at addresses far from its constants and from libm.

    Args:
        level: LLVM's level of optimisation in code generation, 0 to 3.
    Returns:
        The machine; MCJIT takes ownership, so each call creates a new one.
    """
    cpu = cpu_target()
    return _target().create_target_machine(cpu=cpu.name, features=cpu.features, opt=level, jit=True)


@cache
def _identity() -> bytes:
    """Return the first bytes of all object files of this machine; others would crash LLVM."""
    header: bytes = create_machine(1).emit_object(llvm.parse_assembly(""))
    return header[:_IDENTITY]
