"""Functions of Python that are executed as machine code, and stamps of the sources of this code.

Shipped code runs without numba, which need not be installed.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, cached_property, update_wrapper
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from threading import RLock
from types import FunctionType
from typing import Any, TypeVar

from .call_wrapper import ArgumentType, argument_type, plain_value
from .shipped_code import load_code, shipped_name

_LOCK = RLock()


class CompiledFunction:
    """A Python function of numbers, float64 arrays and tuples, executed as machine code.

    Attributes:
        py_func: The Python function.
        stamp: Digest of all sources that the machine code depends on.
        inline: Whether numba inlines the function in those that call it; no code is shipped of it.
    """

    def __init__(self, function: Callable[..., Any], stamp: str, *, inline: bool = False) -> None:
        """Set the function; its code is loaded or generated at the first call.

        Args:
            function: The Python function.
            stamp: Digest of all sources that the machine code depends on.
            inline: Whether numba inlines the function.
        """
        self.py_func, self.stamp, self.inline = function, stamp, inline
        self._call: Callable[..., Any] = self._load_and_call
        self._codes: dict[tuple[ArgumentType, ...], Callable[..., Any]] = {}
        update_wrapper(self, function)

    def __call__(self, *arguments: Any) -> Any:
        """Call the machine code for the types of the arguments."""
        result = self._call(*arguments)
        return self._call_others(arguments) if result is NotImplemented else result

    @cached_property
    def numba_object(self) -> Any:
        """Numba's dispatcher, by which functions that numba compiles refer to this one."""
        from .numba_functions import make_dispatcher

        return make_dispatcher(self.py_func, inline=self.inline)

    def __reduce__(self) -> str:
        """Copy and pickle a function by its name, like functions of Python."""
        return self.py_func.__qualname__

    def has_code(self, types: tuple[ArgumentType, ...]) -> bool:
        """Return whether the code for some types of the arguments is in memory."""
        return types in self._codes

    def _call_others(self, arguments: tuple[Any, ...]) -> Any:
        """Call the code for other types than those of the first call."""
        for code in list(self._codes.values()):
            result = code(*arguments)
            if result is not NotImplemented:
                return result
        return self._load_and_call(*arguments)

    def _load_and_call(self, *arguments: Any) -> Any:
        """Load or generate code for the types of the arguments, and call it."""
        values = tuple(map(plain_value, arguments))
        found = tuple(map(argument_type, values))
        types = tuple(kind for kind in found if kind is not None)
        result: Any = NotImplemented
        if len(types) == len(values):
            with _LOCK:
                if types not in self._codes:
                    name = shipped_name(self.py_func, types, self.stamp)
                    self._codes[types] = load_code(self, name, types)
                    self._call = next(iter(self._codes.values()))
            result = self._codes[types](*values)
        if result is NotImplemented:
            kinds = ", ".join(type(value).__name__ for value in arguments)
            raise TypeError(
                f"'{self.py_func.__name__}' takes Python's numbers, aligned arrays of numbers, and "
                f"tuples, got {kinds}"
            )
        return result


class _NumbaCore:
    """Modules of numba.core, loaded when the generator of an intrinsic uses them."""

    @property
    def types(self) -> Any:
        """The module of numba's types."""
        return import_module("numba.core.types")

    @property
    def cgutils(self) -> Any:
        """The module of numba's functions that emit LLVM instructions."""
        return import_module("numba.core.cgutils")


numba_core = _NumbaCore()


class Intrinsic:
    """A function for compiled code whose LLVM instructions a generator emits.

    Attributes:
        generator: Function of numba's typing context and the types of the arguments.
    """

    def __init__(self, generator: Callable[..., Any], prepare: Callable[[], Any]) -> None:
        """Set the generator, and a function to call before numba compiles the first caller."""
        self.generator, self._prepare = generator, prepare

    def __call__(self, *arguments: Any) -> Any:
        """Raise NotImplementedError, because only compiled code can call an intrinsic."""
        raise NotImplementedError(f"{self.generator.__qualname__} is called by compiled code only")

    @cached_property
    def numba_object(self) -> Any:
        """The object by which functions that numba compiles refer to this one."""
        from .numba_functions import make_numba_intrinsic

        self._prepare()
        return make_numba_intrinsic(self.generator)


_Function = TypeVar("_Function", bound=Callable[..., Any])


def stamp(folder: Path) -> str:
    """Return a digest of the Python sources of compiled functions in the folder of integrators."""
    return sha256(b"".join(path.read_bytes() for path in _sources(folder))).hexdigest()


def _sources(folder: Path) -> list[Path]:
    """Return the files in subfolders, except options of methods, which are never compiled."""
    files = sorted(folder.glob("*/**/*.py"))
    return [path for path in files if not path.is_relative_to(folder / "methods")]


_FOLDER = Path(__file__).parent.parent
SOURCES = stamp(_FOLDER)
_names: set[str] = set()


@cache
def stamp_of(path: Path) -> str:
    """Return the stamp of functions of a source file: SOURCES, and a digest of a file elsewhere."""
    if path in _sources(_FOLDER):
        return SOURCES
    return f"{SOURCES} {sha256(path.read_bytes()).hexdigest()}"


def compiled(function: _Function) -> _Function:
    """Execute a function as machine code, without the GIL; the first call loads or compiles it.

    Machine code contains code inlined from other files. Its stamp makes it stale when any source of
    compiled integrators or the file of the function changes; functions elsewhere call no compiled
    functions of further files.

    Args:
        function: The function.
    Returns:
        A CompiledFunction.
    """
    machine_code: Any = CompiledFunction(function, stamp_of(Path(function.__code__.co_filename)))
    typed: _Function = machine_code
    return typed


def inlined(function: _Function) -> _Function:
    """Mark a function to be compiled only inline, in the functions that call it."""
    machine_code: Any = CompiledFunction(function, SOURCES, inline=True)
    typed: _Function = machine_code
    return typed


def bind_globals(function: _Function, name: str, **values: Any) -> _Function:
    """Return an uncompiled copy of a function with other values of some global names.

    Cached machine code is identified by the name and the bytecode of a function. Copies share
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
    if name in _names:
        raise RuntimeError(
            f"two compiled functions have the name '{name}', so one would run "
            "the machine code of the other. Give them distinct names"
        )
    _names.add(name)
    python: Any = getattr(function, "py_func", function)
    copy: Any = FunctionType(
        python.__code__, {**python.__globals__, **values}, name, python.__defaults__
    )
    copy.__qualname__, copy.__module__ = name, python.__module__
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


def make_intrinsic(
    generator: Callable[..., Any], prepare: Callable[[], Any] = lambda: None
) -> Callable[..., Any]:
    """Return a function for compiled code whose LLVM instructions `generator` emits.

    Args:
        generator: Function of numba's typing context and the types of the arguments, which may use
            `numba_core`.
        prepare: Function to call before numba compiles the first caller.
    Returns:
        The function.
    """
    return Intrinsic(generator, prepare)
