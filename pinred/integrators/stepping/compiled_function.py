"""Functions that are executed as shipped machine code, or compiled by numba where none fits.

numba is loaded only to compile: its import takes longer than loading the shipped code.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, update_wrapper
from threading import RLock
from typing import Any

from .argument_types import ArgumentType, argument_type, plain_value
from .wrapped_code import load_shipped

_LOCK = RLock()


class CompiledFunction:
    """A Python function of numbers, float64 arrays and tuples, executed as machine code.

    Attributes:
        py_func: The Python function.
        stamp: Digest of all sources that the machine code depends on.
        inline: Whether numba inlines the function in those that call it; no code is shipped of it.
    """

    def __init__(self, function: Callable[..., Any], stamp: str, *, inline: bool = False) -> None:
        """Set the function; its code is loaded or compiled at the first call.

        Args:
            function: The Python function.
            stamp: Digest of all sources that the machine code depends on.
            inline: Whether numba inlines the function.
        """
        self.py_func, self.stamp, self.inline = function, stamp, inline
        self._call: Callable[..., Any] = self._find_code
        self._is_compiled = False  # whether numba has compiled it for some types
        self._shipped: tuple[Callable[..., Any], ...] = ()  # all but the first are called later
        self._by_types: dict[tuple[ArgumentType, ...], Callable[..., Any] | None] = {}
        update_wrapper(self, function)

    def __call__(self, *arguments: Any) -> Any:
        """Call the machine code for the types of the arguments."""
        result = self._call(*arguments)
        return self._call_others(arguments) if result is NotImplemented else result

    @cached_property
    def dispatcher(self) -> Any:
        """Numba's dispatcher of the function."""
        from .numba_functions import make_dispatcher

        return make_dispatcher(self.py_func, self.stamp, inline=self.inline)

    @property
    def numba_object(self) -> Any:
        """The object by which functions that numba compiles refer to this one."""
        return self.dispatcher

    def __reduce__(self) -> str:
        """Copy and pickle a function by its name, like functions of Python."""
        return self.py_func.__qualname__

    def _call_others(self, arguments: tuple[Any, ...]) -> Any:
        """Call the code for other types than those of the first call."""
        for shipped in self._shipped[1:]:
            result = shipped(*arguments)
            if result is not NotImplemented:
                return result
        find = self.dispatcher if self._is_compiled else self._find_code
        return find(*arguments)

    def _find_code(self, *arguments: Any) -> Any:
        """Load or compile code for the types of the arguments, and call it."""
        values = tuple(map(plain_value, arguments))
        shipped = self._load(tuple(map(argument_type, values)))
        if shipped is not None:
            result = shipped(*values)
            if result is not NotImplemented:
                return result
        self._is_compiled = True
        if not self._shipped:
            self._call = self.dispatcher
        return self.dispatcher(*arguments)

    def _load(self, types: tuple[ArgumentType | None, ...]) -> Callable[..., Any] | None:
        """Return the shipped code for the types of the arguments, or None."""
        known = tuple(kind for kind in types if kind is not None)
        if self.inline or len(known) < len(types):
            return None
        with _LOCK:
            if known not in self._by_types:
                shipped = load_shipped(self.py_func, known, self.stamp)
                self._by_types[known] = shipped
                if shipped is not None:
                    self._shipped += (shipped,)
                    self._call = self._shipped[0]
            return self._by_types[known]


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
