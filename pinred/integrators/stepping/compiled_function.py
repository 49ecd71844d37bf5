"""Functions of Python that are executed as machine code."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, update_wrapper
from threading import RLock
from typing import Any

from .argument_types import ArgumentType, argument_type, plain_value
from .shipped_code import shipped_name
from .wrapped_code import load_code

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
