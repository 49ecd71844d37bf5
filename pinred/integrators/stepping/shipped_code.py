"""Code of compiled functions: the bitcode that the package ships, and machine code from it.

`python tests/helpers/ship_code.py` writes the bitcode, in files that are named by a key of all that
it depends on.  LLVM reads bitcode of older versions, and the code names no CPU, so the same files
serve all processors and all versions of llvmlite.  Machine code has wrappers that Python calls.
"""

from __future__ import annotations

import lzma
import sys
from collections.abc import Callable, Iterator
from functools import cache
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numpy as np

from ...common.errors import (
    UnsupportedOperationError,
    __version__,
    install_command,
    require_package,
)
from ...common.machine_code import LLVM_LOCK, cpu_target, create_machine, load_object, parse_bitcode
from ...common.object_cache import ObjectCache
from ...common.waiting import notice_of_compiling
from .call_wrapper import (
    COMPILED,
    WRAPPER,
    ArgumentType,
    Bitcode,
    CallWrapper,
    objects_are_as_expected,
)

FOLDER = Path(__file__).parent.parent / "shipped"


def shipped_name(
    function: Callable[..., Any], arguments: tuple[ArgumentType, ...], stamp: str
) -> str:
    """Return the name of the file with the bitcode of a function.

    Args:
        function: The Python function.
        arguments: Types of its arguments.
        stamp: Digest of its sources.
    Returns:
        Name of the function and key of the bitcode.
    """
    types = tuple(map(str, arguments))
    constants = sorted(set(map(repr, _constants(function, set()))))
    parts = (stamp, function.__module__, function.__qualname__, types, constants)
    return f"{function.__name__.lstrip('_')}-{sha256(repr(parts).encode()).hexdigest()[:24]}"


def _constants(function: Callable[..., Any], seen: set[int]) -> Iterator[tuple[str, Any]]:
    """Yield the numbers among the variables of a function and of the functions that it calls.

    NumPy computes some of them when a module is imported, with a round-off of its own.
    """
    code, cells = function.__code__, function.__closure__ or ()
    inner = zip(code.co_freevars, (cell.cell_contents for cell in cells), strict=True)
    for name, value in (*((n, function.__globals__.get(n)) for n in code.co_names), *inner):
        called = getattr(value, "py_func", None)
        if called is not None and id(value) not in seen:
            seen.add(id(value))
            yield from _constants(called, seen)
        elif isinstance(value, (np.ndarray, np.generic)):
            yield name, value.tolist()
        elif isinstance(value, (int, float)):
            yield name, value


def is_shipped(name: str) -> bool:
    """Return whether the package ships the file with the bitcode of a function."""
    return (FOLDER / name).is_file()


def read_shipped(name: str) -> Bitcode:
    """Return the bitcode of a function that is shipped, from the file with a name."""
    result, _, module = lzma.decompress((FOLDER / name).read_bytes()).partition(b"\n")
    return Bitcode(result.decode(), module)


# The cache of the code of all compiled functions. Its folder is chosen once, so that a process
# never compiles a function for two folders.
STORE = ObjectCache()
LEVEL = 3  # of code generation, as in numba


def load_code(function: Any, name: str, types: tuple[ArgumentType, ...]) -> Any:
    """Return the machine code of a function for some types of its arguments.

    Args:
        function: The CompiledFunction.
        name: Name of its bitcode, see `shipped_name`.
        types: Types of its arguments.
    Returns:
        A function that returns NotImplemented for other types.
    Raises:
        MissingPackageError: Its bitcode is not shipped, and numba is not installed.
        UnsupportedOperationError: Python's objects differ from the wrapper's expectations.
    """
    if not objects_are_as_expected():
        raise UnsupportedOperationError(
            "compiled integrators read Python's objects in memory, and this Python stores them in "
            'another way. Use CPython with 64 bits, or simulate(…, engine="pinocchio")'
        )
    key = key_of(name)
    data = STORE.get(key)
    if data is None:
        with notice_of_compiling("an integrator, once for all robots"):
            bitcode = bitcode_of(function, name, types)
            wrapper = CallWrapper(function.__name__, types, bitcode.result)
            code = _compile(wrapper, bitcode.module)
        STORE.put(key, bitcode.result.encode() + b"\n" + code)
    else:
        # The object cache has verified the user's signature.
        result, _, code = data.partition(b"\n")
        wrapper = CallWrapper(function.__name__, types, result.decode())
    return wrapper.bind(load_object(code, WRAPPER))


def bitcode_of(function: Any, name: str, types: tuple[ArgumentType, ...]) -> Bitcode:
    """Return the bitcode of a function: what is shipped, or else what numba compiles.

    Args:
        function: The CompiledFunction.
        name: Name of its bitcode.
        types: Types of its arguments.
    Returns:
        The bitcode.
    Raises:
        MissingPackageError: It is not shipped, and numba is not installed.
    """
    if is_shipped(name):
        return read_shipped(name)
    require_package(
        "numba",
        f"no machine code is shipped of '{function.__name__}'. Methods with coefficients of your "
        f"own, and changed sources, are compiled by numba: {install_command('methods')}",
    )
    from . import numba_functions

    return numba_functions.compile_bitcode(function, name, types)


def key_of(name: str) -> str:
    """Return the key of the machine code of a function with its wrapper."""
    cpu = cpu_target()
    parts = ("wrapped", name, *_environment(), cpu.name, cpu.features)
    return sha256(repr(parts).encode()).hexdigest()


@cache
def _environment() -> tuple[str, ...]:
    """Return the versions on which the machine code depends."""
    python = f"{sys.implementation.cache_tag}{getattr(sys, 'abiflags', '')}"
    versions = __version__, python, np.__version__, version("llvmlite")
    return (*versions, llvm.get_process_triple())


def check_parameters(wrapper: CallWrapper, module: Any) -> None:
    """Raise RuntimeError if a function has other parameters than its wrapper passes."""
    parameters = [str(p.type) for p in module.get_function(COMPILED).arguments]
    if parameters != wrapper.parameters:
        raise RuntimeError(f"the bitcode takes {parameters}, but is passed {wrapper.parameters}")


def _compile(wrapper: CallWrapper, bitcode: bytes) -> bytes:
    """Generate machine code of a function and its wrapper.

    Args:
        wrapper: The wrapper.
        bitcode: Bitcode of the function.
    Returns:
        The object code.
    """
    with LLVM_LOCK:
        machine = create_machine(LEVEL)
        context = llvm.create_context()
        module = parse_bitcode(bitcode, context)
        check_parameters(wrapper, module)
        module.link_in(llvm.parse_assembly(wrapper.text, context))
        code: bytes = machine.emit_object(module)
        module.close()  # before its context is deleted
    return code
