"""Machine code of shipped functions, with the wrappers by which Python calls them without numba."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from hashlib import sha256
from typing import Any

import llvmlite.binding as llvm
import numpy as np

from ...common.compile_notice import notice_of_compiling
from ...common.cpu_target import cpu_target
from ...common.machine_code import LLVM_LOCK, create_machine, load_object
from ...common.object_cache import ObjectCache
from ...common.version import __version__
from . import shipped_code
from .argument_types import ArgumentType
from .call_wrapper import COMPILED, WRAPPER, CallWrapper, objects_are_as_expected

# The cache of the code of all compiled functions. Its folder is chosen once, so that a process
# never compiles a function for two folders.
STORE = ObjectCache()
_LEVEL = 3  # of code generation, as in numba


def load_shipped(
    function: Callable[..., Any], arguments: tuple[ArgumentType, ...], stamp: str
) -> Callable[..., Any] | None:
    """Return a shipped function for some types of its arguments, without loading numba.

    Args:
        function: The Python function.
        arguments: Types of its arguments.
        stamp: Digest of its sources.
    Returns:
        A function that returns NotImplemented for other types. None if no code is shipped, or if
        objects of Python, the code or numba's settings differ from the wrapper's expectations.
    """
    name = shipped_code.shipped_name(function, arguments, stamp)
    # NUMBA_CPU_NAME applies to numba alone.
    if not shipped_code.is_shipped(name) or os.environ.get("NUMBA_CPU_NAME"):
        return None
    if not objects_are_as_expected():
        return None
    key = _key(name)
    data = STORE.get(key)
    if data is None:
        bitcode = shipped_code.read_shipped(name)
        wrapper = CallWrapper(function.__name__, arguments, bitcode.result)
        with notice_of_compiling("an integrator, once for all robots"):
            code = _compile(wrapper, bitcode.module)
        if code is None:
            return None
        STORE.put(key, bitcode.result.encode() + b"\n" + code)
    else:
        # The object cache has verified the user's signature.
        result, _, code = data.partition(b"\n")
        wrapper = CallWrapper(function.__name__, arguments, result.decode())
    return wrapper.bind(load_object(code, WRAPPER))


def _key(name: str) -> str:
    """Return the key of the machine code of a shipped function with its wrapper."""
    python = f"{sys.implementation.cache_tag}{getattr(sys, 'abiflags', '')}"
    cpu = cpu_target()
    parts = (
        "wrapped", name, shipped_code.environment(), __version__, python, np.__version__,
        cpu.name, cpu.features,
    )  # fmt: skip
    return sha256(repr(parts).encode()).hexdigest()


def _compile(wrapper: CallWrapper, bitcode: bytes) -> bytes | None:
    """Generate machine code of a function and its wrapper.

    Args:
        wrapper: The wrapper.
        bitcode: Bitcode of the function.
    Returns:
        The object code, or None if the function has other parameters than the wrapper expects.
    """
    with LLVM_LOCK:
        machine = create_machine(_LEVEL)
        context = llvm.create_context()
        module = llvm.parse_bitcode(bitcode, context)
        parameters = [str(p.type) for p in module.get_function(COMPILED).arguments]
        code: bytes | None = None
        if parameters == wrapper.parameters:
            module.link_in(llvm.parse_assembly(wrapper.text, context))
            code = machine.emit_object(module)
        module.close()  # before its context is deleted
    return code
