"""Bitcode of compiled functions that the package ships, found by a key of all it depends on.

`python -m pinred.cli.ship_code` writes it.  Without bitcode, or with bitcode of other versions or
sources, functions are compiled: the results are equal, but the first call waits longer.
"""

from __future__ import annotations

import lzma
import platform
from collections.abc import Callable, Iterator
from functools import cache
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite.binding as llvm
import numpy as np

FOLDER = Path(__file__).parent.parent / "shipped"  # with a folder for each `environment`
# The CPU whose costs decide how code is optimised. Its instructions are not assumed: machine code
# is generated for the CPU that runs it. Other architectures optimise for the machine at hand.
OPTIMISED_FOR = {"x86_64": "x86-64-v3"}.get(platform.machine(), "")


class Bitcode(NamedTuple):
    """Optimised code of a function.

    Attributes:
        result: Name of the type of the result.
        module: LLVM bitcode.
    """

    result: str
    module: bytes


@cache
def environment() -> str:
    """Return the name of the folder with bitcode for the versions and the target at hand."""
    triple: str = llvm.get_process_triple()
    target = f"{triple}-{OPTIMISED_FOR}" if OPTIMISED_FOR else triple
    return f"numba-{version('numba')}-llvmlite-{version('llvmlite')}-{target}"


def shipped_name(function: Callable[..., Any], arguments: tuple[Any, ...], stamp: str) -> str:
    """Return the name of the file with the bitcode of a function.

    Args:
        function: The Python function.
        arguments: Types of its arguments, numba's or those of `argument_type`.
        stamp: Digest of its sources.
    Returns:
        Name of the function and key of the bitcode.
    """
    types = tuple(str(argument) for argument in arguments)
    constants = sorted(set(map(repr, _constants(function, set()))))
    parts = (environment(), stamp, function.__module__, function.__qualname__, types, constants)
    return f"{function.__name__.lstrip('_')}-{sha256(repr(parts).encode()).hexdigest()[:24]}"


def _constants(function: Callable[..., Any], seen: set[int]) -> Iterator[tuple[str, Any]]:
    """Yield the numbers among the globals of a function and of the functions that it calls.

    NumPy computes some of them when a module is imported, with a round-off of its own.
    """
    for name in function.__code__.co_names:
        value = function.__globals__.get(name)
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
    return (FOLDER / environment() / name).is_file()


def find_shipped(name: str) -> Bitcode | None:
    """Return the bitcode of a shipped function.

    Args:
        name: Name of its file, see `shipped_name`.
    Returns:
        The bitcode, or None if it is not shipped.
    """
    return read_shipped(name) if is_shipped(name) else None


def read_shipped(name: str) -> Bitcode:
    """Return the bitcode of a function that is shipped, from the file with a name."""
    data = (FOLDER / environment() / name).read_bytes()
    result, _, module = lzma.decompress(data).partition(b"\n")
    return Bitcode(result.decode(), module)


def write_shipped(name: str, bitcode: Bitcode) -> None:
    """Write the bitcode of a function to the folder of shipped bitcode.

    Args:
        name: Name of its file, see `shipped_name`.
        bitcode: The bitcode.
    """
    folder = FOLDER / environment()
    folder.mkdir(parents=True, exist_ok=True)
    data = f"{bitcode.result}\n".encode() + bitcode.module
    (folder / name).write_bytes(lzma.compress(data, preset=9 | lzma.PRESET_EXTREME))
