"""Bitcode of compiled functions that the package ships, found by a key of all it depends on.

`python -m pinred.cli.ship_code` writes it.  LLVM reads bitcode of older versions, and the code
names no CPU, so the same files serve all processors and all versions of llvmlite.
"""

from __future__ import annotations

import lzma
from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .argument_types import ArgumentType

FOLDER = Path(__file__).parent.parent / "shipped"


class Bitcode(NamedTuple):
    """Optimised code of a function.

    Attributes:
        result: Name of the type of the result.
        module: LLVM bitcode.
    """

    result: str
    module: bytes


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


def write_shipped(name: str, bitcode: Bitcode) -> None:
    """Write the bitcode of a function to the folder of shipped bitcode.

    Args:
        name: Name of its file, see `shipped_name`.
        bitcode: The bitcode.
    """
    FOLDER.mkdir(parents=True, exist_ok=True)
    data = f"{bitcode.result}\n".encode() + bitcode.module
    (FOLDER / name).write_bytes(lzma.compress(data, preset=9 | lzma.PRESET_EXTREME))
