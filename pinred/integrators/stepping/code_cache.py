"""Machine code of numba functions, kept in the signed object cache of pinred.

numba's own cache needs a writable folder beside the sources or in the home of the user, and runs
whatever it finds there.  The object cache needs neither, and verifies a signature first.  Code that
it does not contain is generated from the bitcode that the package ships, or else compiled.
"""

from __future__ import annotations

import pickle
import sys
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from importlib.metadata import version
from typing import Any

from numba.core import sigutils
from numba.core.caching import CompileResultCacheImpl
from numba.core.serialize import dumps

from ...common.compile_notice import notice_of_compiling
from ...common.version import __version__
from . import shipped_code, wrapped_code
from .portable_code import link_bitcode

# numba's functions have no type hints.
_dumps: Callable[[Any], bytes] = dumps
_normalize: Callable[[Any], tuple[tuple[Any, ...], Any]] = sigutils.normalize_signature
# These methods do not use their first argument, an object that needs a folder of its own.
_reduce: Callable[..., Any] = CompileResultCacheImpl.reduce
_rebuild: Callable[..., Any] = CompileResultCacheImpl.rebuild


@cache
def _environment() -> tuple[str, ...]:
    """Return what the machine code depends on besides the function and the CPU."""
    python = f"{sys.implementation.cache_tag}{getattr(sys, 'abiflags', '')}"
    return __version__, version("numba"), version("llvmlite"), python


class CodeCache:
    """The cache of one numba function, with one object for each of its signatures.

    It has the methods of numba's caches that a dispatcher calls.

    Attributes:
        dispatcher: numba's dispatcher of the function.
        function: The Python function.
        stamp: Digest of all sources that the machine code depends on.
    """

    def __init__(self, dispatcher: Any, function: Callable[..., Any], stamp: str) -> None:
        """Set the function without accessing the disk.

        Args:
            dispatcher: numba's dispatcher of the function.
            function: The Python function, whose globals contain no objects of numba.
            stamp: Digest of all sources that the machine code depends on.
        """
        self.dispatcher, self.function, self.stamp = dispatcher, function, stamp

    @property
    def cache_path(self) -> str:
        """The folder of the object cache."""
        return str(wrapped_code.STORE.folder)

    def compute_key(self, signature: Any, codegen: Any) -> str:
        """Compute the key of the machine code for one signature.

        Args:
            signature: Types of the arguments, as numba passes them to its caches.
            codegen: numba's code generator.
        Returns:
            64 hexadecimal digits.
        """
        function = self.function
        arguments, result = _normalize(signature)
        cells = tuple(cell.cell_contents for cell in function.__closure__ or ())
        parts = (
            *_environment(),
            self.stamp,
            *(str(value) for value in codegen.magic_tuple()),
            f"{function.__module__}.{function.__qualname__}",
            str(function.__code__.co_firstlineno),
            sha256(function.__code__.co_code).hexdigest(),
            sha256(_dumps(cells) if cells else b"").hexdigest(),
            str(result),
            *(str(argument) for argument in arguments),
        )
        return sha256(repr(parts).encode()).hexdigest()

    def shipped_name(self, arguments: tuple[Any, ...]) -> str:
        """Return the name of the file with the bitcode for some types of the arguments."""
        return shipped_code.shipped_name(self.function, arguments, self.stamp)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load the machine code for a signature, or generate it from the shipped bitcode.

        Args:
            sig: Types of the arguments.
            target_context: numba's target.
        Returns:
            The compile result, or None if there is neither a trusted object nor bitcode.
        """
        target_context.refresh()
        code = wrapped_code.STORE.get(self.compute_key(sig, target_context.codegen()))
        if code is not None:
            # The object cache has verified the user's signature, so the pickle is the user's own.
            return _rebuild(None, target_context, pickle.loads(code))
        arguments, _ = _normalize(sig)
        shipped = shipped_code.find_shipped(self.shipped_name(arguments))
        if shipped is None:
            return None
        with notice_of_compiling("an integrator, once for all robots"):
            result = link_bitcode(self.dispatcher, arguments, shipped)
        self.save_overload(sig, result)
        return result

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store the machine code for a signature, unless it contains addresses of this process.

        Args:
            sig: Types of the arguments.
            data: The compile result.
        """
        if not data.library.has_dynamic_globals:
            wrapped_code.STORE.put(self.compute_key(sig, data.codegen), _dumps(_reduce(None, data)))

    def flush(self) -> None:
        """Do nothing: `pinred cache --clear` removes all objects."""
