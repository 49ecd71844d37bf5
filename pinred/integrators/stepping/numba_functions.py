"""Compilation with numba of functions for which no shipped code fits."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import CellType, CodeType, FunctionType
from typing import Any

import numba
from numba.extending import intrinsic

from ...common.cpu_target import pin_numba
from .code_cache import CodeCache
from .numba_notice import announce_compilations
from .portable_code import PortableCompiler

pin_numba(numba.config)  # before the first function is compiled
announce_compilations()
# Without fast-math, results do not depend on where a function is inlined. Compiled functions
# never allocate arrays, so reference counting (_nrt) is off and views of rows cost nothing.
# Compiled functions are called from Python and from each other, never through C.
_OPTIONS: Any = {
    "nogil": True, "error_model": "numpy", "_nrt": False, "no_cfunc_wrapper": True,
    "pipeline_class": PortableCompiler,
}  # fmt: skip


def make_dispatcher(function: Callable[..., Any], stamp: str, *, inline: bool) -> Any:
    """Return numba's dispatcher of a function.

    Args:
        function: The Python function.
        stamp: Digest of all sources that the machine code depends on.
        inline: Whether numba inlines the function in those that call it.
    Returns:
        The dispatcher, which keeps its machine code in the object cache.
    """
    python = _with_numba(function)
    if inline:
        return numba.njit(inline="always", **_OPTIONS)(python)
    dispatcher: Any = numba.njit(**_OPTIONS)(python)
    # numba offers no public way to set the cache.
    vars(dispatcher)["_cache"] = CodeCache(dispatcher, function, stamp)
    return dispatcher


def make_numba_intrinsic(generator: Callable[..., Any]) -> Any:
    """Return numba's object for a function whose LLVM instructions a generator emits."""
    make: Callable[..., Any] = intrinsic
    return make(generator)


def _with_numba(function: Callable[..., Any]) -> Any:
    """Return a copy of a Python function that refers to numba's objects of compiled functions."""
    names = set(_names(function.__code__))
    values = {k: _numba_object(v) if k in names else v for k, v in function.__globals__.items()}
    cells = function.__closure__ or ()
    closure = tuple(CellType(_numba_object(cell.cell_contents)) for cell in cells)
    copy = FunctionType(
        function.__code__, values, function.__name__, function.__defaults__, closure
    )
    copy.__qualname__, copy.__module__ = function.__qualname__, function.__module__
    copy.__doc__, copy.__kwdefaults__ = function.__doc__, function.__kwdefaults__
    return copy


def _names(code: CodeType) -> Iterator[str]:
    """Yield the global names in a function and in the functions that it contains."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)


def _numba_object(value: Any) -> Any:
    return value.numba_object if hasattr(type(value), "numba_object") else value
