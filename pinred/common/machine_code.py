"""Machine code in memory: the CPU and LLVM's target machine, and object code loaded from bytes.

All code is compiled for this machine's CPU, or the one PINRED_CPU names.  Code for different CPUs
differs in its fused multiply-adds, and so in round-off.  With the same PINRED_CPU, machines compile
the same code.

An object may be an archive of object codes that call each other, in the format of `ar`.
"""

from __future__ import annotations

import ctypes.util
import os
import platform
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import chain
from threading import Lock
from typing import Any, NamedTuple, NoReturn

import llvmlite.binding as llvm

from .errors import InputError, NotCopyable

CPU_VARIABLE = "PINRED_CPU"
# Code generation at level 1 emits code of the same results and speed in a tenth less time than 2.
LEVEL = 1
_LEVEL_VARIABLE = "PINRED_CODE_LEVEL"
_V2 = ("cx16", "popcnt", "sahf", "sse3", "sse4.1", "sse4.2", "ssse3")
_V3 = (*_V2, "avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe")
_V4 = (*_V3, "avx512bw", "avx512cd", "avx512dq", "avx512f", "avx512vl")
# CPU names of LLVM, and the features that each needs beyond the architecture's baseline.
_X86 = {"x86-64": (), "x86-64-v2": _V2, "x86-64-v3": _V3, "x86-64-v4": _V4}
_ARM: dict[str, tuple[str, ...]] = {"generic": ()}
_WITH_FMA = {"x86-64-v3", "x86-64-v4", "generic"}  # `generic` is aarch64, where all have it


class CPUTarget(NamedTuple):
    """A CPU as LLVM describes it.

    Attributes:
        name: LLVM's name of the CPU.
        features: Features added to those of the name, in LLVM's format.
        fma: Whether the CPU has a fused multiply-add.
    """

    name: str
    features: str
    fma: bool


def cpu_target() -> CPUTarget:
    """Return the CPU that machine code is compiled for.

    Returns:
        The CPU that the environment variable PINRED_CPU names, or this machine's.
    Raises:
        InputError: PINRED_CPU is unknown, or this machine lacks some of its features.
    """
    return _target_named(os.environ.get(CPU_VARIABLE, ""))


def code_level() -> int:
    """Return LLVM's level of optimisation in the code generation of kernels.

    Level 0 takes a third of the time of level 1.  Its code is slower, and fuses fewer products and
    sums, so that last bits differ.

    Returns:
        The level that the environment variable PINRED_CODE_LEVEL states, or `LEVEL`.
    Raises:
        InputError: PINRED_CODE_LEVEL is unknown.
    """
    text = os.environ.get(_LEVEL_VARIABLE, "") or str(LEVEL)
    if text not in ("0", "1", "2", "3"):
        raise InputError(
            f"{_LEVEL_VARIABLE}: expected 0, 1, 2 or 3, got {text!r}. Unset it for {LEVEL}"
        )
    return int(text)


@cache
def _target_named(name: str) -> CPUTarget:
    features = llvm.get_host_cpu_features()
    is_arm = platform.machine().lower() in {"arm64", "aarch64"}
    if not name:
        fma = is_arm or bool(features.get("fma"))
        return CPUTarget(llvm.get_host_cpu_name(), features.flatten(), fma)
    targets = _ARM if is_arm else _X86
    if name not in targets:
        raise InputError(
            f"{CPU_VARIABLE}: expected one of {', '.join(targets)}, got {name!r}. "
            "Unset it to compile for this machine"
        )
    missing = [feature for feature in targets[name] if not features.get(feature)]
    if missing:
        raise InputError(
            f"{CPU_VARIABLE}: expected a CPU whose features this machine has, got {name!r}, but "
            f"{', '.join(missing)} are missing. Use the newest level that all machines have"
        )
    return CPUTarget(name, "", name in _WITH_FMA)


_IDENTITY = 16  # number of bytes that encode format, word size and byte order
_ARCHIVE = b"!<arch>\n"
_MEMBER = 60  # length of the header of an archive's member
# Functions of llvmlite's library that `emit_object` calls.
_UNLOCKED = (
    "TargetMachineEmitToMemory", "GetBufferStart", "GetBufferSize", "DisposeMemoryBuffer",
    "DisposeString",
)  # fmt: skip

LLVM_LOCK = Lock()  # common contexts and engines of LLVM are used by one thread at a time


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
        code: The object code, or an archive.
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
        codes: Object code, or an archive, by the name of its function.
    Returns:
        The functions, in order.
    Raises:
        InputError: As for `load_object`.
    """
    object_codes = {name: list(_parts(code)) for name, code in codes.items()}
    for name, code in codes.items():
        if not all(object_code[:_IDENTITY] == _identity() for object_code in object_codes[name]):
            raise InputError(
                f"the {len(code)} bytes for '{name}' are not object code for this machine"
            )
    with LLVM_LOCK:
        machine = create_machine(1)
        # Use the global context, because a private one would have to outlive the engine.
        engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
        for object_code in chain.from_iterable(object_codes.values()):
            engine.add_object_file(llvm.ObjectFileRef.from_data(object_code))
        engine.finalize_object()
        addresses = {name: engine.get_function_address(name) for name in codes}
    for name, address in addresses.items():
        if not address:
            raise InputError(f"the object code has no function '{name}'")
    return tuple(NativeCode(name, address, engine) for name, address in addresses.items())


def archive_of(parts: Sequence[bytes]) -> bytes:
    """Return an archive of object codes.

    Args:
        parts: The object codes, none of which contains a symbol of another one.
    Returns:
        The archive.
    """
    members = (
        f"{f'{k}.o/':<16}{0:<12}{0:<6}{0:<6}{'100600':<8}{len(code):<10}`\n".encode()
        + code
        + b"\n" * (len(code) % 2)
        for k, code in enumerate(parts)
    )
    return _ARCHIVE + b"".join(members)


def _parts(code: bytes) -> Iterator[bytes]:
    """Yield the object codes of an archive, or the object code itself."""
    if not code.startswith(_ARCHIVE):
        yield code
        return
    at = len(_ARCHIVE)
    while at < len(code):
        size = int(code[at + 48 : at + 58])
        yield code[at + _MEMBER : at + _MEMBER + size]
        at += _MEMBER + size + size % 2


def parse_bitcode(code: bytes, context: llvm.ContextRef) -> llvm.ModuleRef:
    """Parse bitcode that names no CPU, and retarget it to this machine.

    Args:
        code: LLVM bitcode, from any machine on which integers and pointers have 64 bits.
        context: The context of the module.
    Returns:
        The module.
    """
    machine = create_machine(1)
    module = llvm.parse_bitcode(code, context)
    module.triple, module.data_layout = machine.triple, str(machine.target_data)
    return module


def emit_object(machine: llvm.TargetMachine, module: llvm.ModuleRef) -> bytes:
    """Generate object code, at the same time as other threads.

    llvmlite allows one call of LLVM at a time in all threads. LLVM itself requires this only of
    calls with the same context.

    Args:
        machine: The target machine; no other thread may use it.
        module: The module; no other thread may use its context.
    Returns:
        The object code.
    Raises:
        RuntimeError: LLVM cannot generate code of the module.
    """
    library, message = _unlocked_library(), ctypes.c_char_p()
    if library is None:
        code: bytes = machine.emit_object(module)
        return code
    buffer = library.LLVMPY_TargetMachineEmitToMemory(machine, module, 1, ctypes.byref(message))
    if not buffer:
        text = (message.value or b"").decode(errors="replace")
        library.LLVMPY_DisposeString(message)
        raise RuntimeError(f"LLVM cannot generate machine code: {text}")
    try:
        size = library.LLVMPY_GetBufferSize(buffer)
        return ctypes.string_at(library.LLVMPY_GetBufferStart(buffer), size)
    finally:
        library.LLVMPY_DisposeMemoryBuffer(buffer)


@cache
def _unlocked_library() -> ctypes.CDLL | None:
    """Return the library of llvmlite, with functions that do not wait for its lock.

    They are not part of llvmlite's interface. Return None if this version of it lacks them.
    """
    try:
        library = ctypes.CDLL(llvm.ffi.lib._name)  # noqa: SLF001 - llvmlite's substitute for a CDLL
        for name in _UNLOCKED:
            getattr(library, f"LLVMPY_{name}")
    except (AttributeError, OSError, TypeError):
        return None
    library.LLVMPY_TargetMachineEmitToMemory.argtypes = (
        ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int, ctypes.POINTER(ctypes.c_char_p),
    )  # fmt: skip
    library.LLVMPY_TargetMachineEmitToMemory.restype = ctypes.c_void_p
    for name in ("GetBufferStart", "GetBufferSize", "DisposeMemoryBuffer"):
        getattr(library, f"LLVMPY_{name}").argtypes = (ctypes.c_void_p,)
    library.LLVMPY_GetBufferStart.restype = ctypes.c_void_p
    library.LLVMPY_GetBufferSize.restype = ctypes.c_size_t
    library.LLVMPY_DisposeMemoryBuffer.restype = None
    library.LLVMPY_DisposeString.argtypes = (ctypes.c_char_p,)
    library.LLVMPY_DisposeString.restype = None
    return library


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


def available_processors() -> int:
    """Return the number of processors that this process may use, at least 1."""
    affinity = getattr(os, "sched_getaffinity", None)  # macOS has none
    return len(affinity(0)) if affinity is not None else os.cpu_count() or 1


def spare_processors() -> int:
    """Return how many processors this process may use in addition to one."""
    return available_processors() - 1
