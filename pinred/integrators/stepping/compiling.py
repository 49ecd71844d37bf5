"""Compilation of functions with numba, and cache stamps that depend on all sources."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from hashlib import sha256
from pathlib import Path
from types import FunctionType
from typing import Any, TypeVar

import numba
from numba.extending import intrinsic

from ...common.cpu_target import pin_numba
from .code_cache import CodeCache
from .numba_notice import announce_compilations
from .portable_code import PortableCompiler

_Function = TypeVar("_Function", bound=Callable[..., Any])
pin_numba(numba.config)  # before the first function is compiled
announce_compilations()


def stamp(folder: Path) -> str:
    """Return a digest of the Python sources of compiled functions in the folder of integrators."""
    return sha256(b"".join(path.read_bytes() for path in _sources(folder))).hexdigest()


def _sources(folder: Path) -> list[Path]:
    """Return the files in subfolders, except options of methods, which are never compiled."""
    files = sorted(folder.glob("*/**/*.py"))
    return [path for path in files if not path.is_relative_to(folder / "methods")]


_FOLDER = Path(__file__).parent.parent
SOURCES = stamp(_FOLDER)
# Without fast-math, results do not depend on where a function is inlined. Compiled functions
# never allocate arrays, so reference counting (_nrt) is off and views of rows cost nothing.
# Compiled functions are called from Python and from each other, never through C.
_OPTIONS: Any = {
    "nogil": True, "error_model": "numpy", "_nrt": False, "no_cfunc_wrapper": True,
    "pipeline_class": PortableCompiler,
}  # fmt: skip
_names: set[str] = set()


@cache
def stamp_of(path: Path) -> str:
    """Return the stamp of functions of a source file: SOURCES, and a digest of a file elsewhere."""
    if path in _sources(_FOLDER):
        return SOURCES
    return f"{SOURCES} {sha256(path.read_bytes()).hexdigest()}"


def compiled(function: _Function) -> _Function:
    """Compile a function at its first call, without the GIL, and cache it on disk."""
    dispatcher: Any = numba.njit(**_OPTIONS)(function)
    # Machine code contains code inlined from other files. The stamp makes it stale when any source
    # of compiled integrators or the file of the function changes; functions elsewhere call no
    # compiled functions of further files. numba offers no public way to set the cache.
    found = stamp_of(Path(function.__code__.co_filename))
    vars(dispatcher)["_cache"] = CodeCache(dispatcher, found)
    typed: _Function = dispatcher
    return typed


def inlined(function: _Function) -> _Function:
    """Mark a function to be compiled only inline, in the functions that call it."""
    typed: _Function = numba.njit(inline="always", **_OPTIONS)(function)
    return typed


def bind_globals(function: _Function, name: str, **values: Any) -> _Function:
    """Return an uncompiled copy of a function with other values of some global names.

    numba identifies cached machine code by the name and the bytecode of a function. Copies share
    their bytecode, so each needs a unique name; otherwise one would load another's machine code.

    Args:
        function: The function, compiled or not.
        name: Unique name of the copy, the same in every process.
        **values: Values of global names.
    Returns:
        The copy.
    Raises:
        RuntimeError: Another copy has this name.
    """
    if isinstance(function, numba.core.dispatcher.Dispatcher):
        function = function.py_func
    if name in _names:
        raise RuntimeError(
            f"two compiled functions have the name '{name}', so one would run "
            "the machine code of the other. Give them distinct names"
        )
    _names.add(name)
    copy: Any = FunctionType(
        function.__code__, {**function.__globals__, **values}, name, function.__defaults__
    )
    copy.__qualname__, copy.__module__ = name, function.__module__
    typed: _Function = copy
    return typed


def unbound(*arguments: Any) -> Any:
    """Placeholder for a function that `bind_globals` replaces.

    Raises:
        NotImplementedError: Always, because only bound copies can be called.
    """
    raise NotImplementedError


class Bindings:
    """Values of global names for one method, and compiled copies of functions bound to them.

    Attributes:
        values: Values of the global names, including the copies that `add` has made.
    """

    def __init__(self, prefix: str, **values: Any) -> None:
        """Start with values of some names; `prefix` is the unique start of the copies' names."""
        self._prefix, self.values = prefix, values

    def add(
        self, function: Any, compile_as: Callable[[Any], Any] = inlined, name: str | None = None
    ) -> Any:
        """Bind a function to the current values, and add the bound copy to the values.

        Args:
            function: The function.
            compile_as: `inlined` or `compiled`.
            name: Global name of the copy; None for the name of the function.
        Returns:
            The copy.
        """
        unique = f"{self._prefix}_{function.__name__}"
        copy = compile_as(bind_globals(function, unique, **self.values))
        self.values[name or function.__name__] = copy
        return copy


def make_intrinsic(generator: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function for compiled code whose LLVM instructions `generator` emits."""
    function: Callable[..., Any] = intrinsic(generator)
    return function
