"""Functions made machine code, and stamps that keep it on disk from being taken for another's."""

from __future__ import annotations

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from types import FunctionType
from typing import Any, TypeVar

import numba
from numba.extending import intrinsic

_Function = TypeVar("_Function", bound=Callable[..., Any])


def stamp(folder: Path) -> str:
    """Return a digest of all sources in a folder, those in folders below it too."""
    paths = sorted(folder.rglob("*.py"))
    return sha256(b"".join(path.read_bytes() for path in paths)).hexdigest()


SOURCES = stamp(Path(__file__).parent.parent)
# No fast-math: numbers do not depend on where a function is inlined.  Nothing here makes an
# array, so that nobody has to count who holds one: views of rows cost nothing (_nrt).
_OPTIONS: Any = {"nogil": True, "error_model": "numpy", "_nrt": False}
_bound: set[str] = set()


def compiled(function: _Function) -> _Function:
    """Compile at the first call, keep the machine code on disk, run without the GIL."""
    out: Any = numba.njit(cache=True, **_OPTIONS)(function)
    # numba takes machine code from disk as long as the file of the function is the same,
    # though it holds what other files have said.  Here it is as old as all of them.
    out._cache._cache_file._source_stamp = SOURCES
    typed: _Function = out
    return typed


def woven(function: _Function) -> _Function:
    """Compile a function only as a part of those that call it, written out in their place."""
    typed: _Function = numba.njit(inline="always", **_OPTIONS)(function)
    return typed


def bound(function: _Function, name: str, **found: Any) -> _Function:
    """Return a copy of a function, not compiled, that finds `found` under some global names.

    numba tells machine code on disk by the name of a function and its instructions, which are
    the same for all copies: without a name of its own each would load that of another.  So a
    name is given once only.  Raises RuntimeError.
    """
    if isinstance(function, numba.core.dispatcher.Dispatcher):
        function = function.py_func
    if name in _bound:
        raise RuntimeError(f"two functions cannot both be called '{name}': one would run the other")
    _bound.add(name)
    space = {**function.__globals__, **found}
    copy: Any = FunctionType(function.__code__, space, name, function.__defaults__)
    copy.__qualname__, copy.__module__ = name, function.__module__
    typed: _Function = copy
    return typed


def make_intrinsic(generator: Callable[..., Any]) -> Callable[..., Any]:
    """Return the function for compiled code whose instructions `generator` gives."""
    out: Callable[..., Any] = intrinsic(generator)
    return out
