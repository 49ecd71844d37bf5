"""A function of arrays as XLA calls it: its foreign function interface, read without a compiler.

XLA gives a handler the address of a call frame, a structure of C (xla/ffi/api/c_api.h, which
jaxlib brings along; version 0 of it).  It is read as words of eight bytes; the places here and in
`call_frame` are those of the fields that count, and what newer versions append is not looked at.
One handler serves everything: an attribute of the call, a number, says which function is meant.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np

from ...common.arrays import Array
from ...common.memo import once_for_all
from .call_frame import (
    API,
    ARGUMENT_LIST,
    ARGUMENTS,
    DATA,
    DIMS,
    DOUBLE,
    EXTENSION,
    FLOAT,
    RANK,
    RESULT_LIST,
    RESULTS,
    TYPE,
    function_of,
    give_column,
    has_extension,
    take_column,
)

TARGET = "pinred_function"


@dataclass(frozen=True)
class Function:
    """A function that XLA calls.

    one: of a column, the inputs one after another, (size,), all outputs one after another.
    many: of inputs with leading axes, which fills outputs.
    """

    one: Callable[[Array], Array]
    size: int
    many: Callable[[Sequence[Any], Sequence[Any]], None]


_FRAME_WORDS, _BUFFER_WORDS = 21, 6
# An extension of type 1 asks for the version; its metadata, the whole of which begins with a
# version, too, as the API does after its own two words.
_ASKS_FOR_VERSION, _METADATA = 1, 3
_VERSION_IN_METADATA, _VERSION_IN_API, _VERSION_NUMBERS = 1, 2, 2
_MAKE_ERROR = 6
_INVALID, _INTERNAL = 3, 13  # codes of errors
_FLOATS: dict[int, Any] = {FLOAT: ctypes.c_float, DOUBLE: ctypes.c_double}


class _ErrorArguments(ctypes.Structure):
    _fields_ = [
        ("size", ctypes.c_size_t),
        ("extension", ctypes.c_void_p),
        ("message", ctypes.c_char_p),
        ("code", ctypes.c_int),
    ]


_make_error = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.POINTER(_ErrorArguments))
_functions: dict[int, Function] = {}
_numbers = count()


def numbered(function: Function) -> int:
    """Return the number by which calls find a function from now on.

    It stays for as long as the process lives, for nobody says when the last program that calls it
    is gone.
    """
    number = next(_numbers)
    _functions[number] = function
    return number


@once_for_all
def register() -> None:
    """Tell XLA of the handler, for the processor.  Calls name TARGET and `function=` a number."""
    import jax

    jax.ffi.register_ffi_target(TARGET, jax.ffi.pycapsule(_HANDLER), platform="cpu")


def _words(address: int, size: int) -> Any:
    return (ctypes.c_int64 * size).from_address(address)


def _arrays(size: int, where: int) -> list[Any]:
    """Return so many buffers of a frame as arrays, in their places."""
    out = []
    for address in _words(where, size):
        buffer = _words(address, _BUFFER_WORDS)
        shape, length = _words(buffer[DIMS], buffer[RANK])[:], 1
        for each in shape:
            length *= each
        number = _FLOATS[buffer[TYPE] & 0xFFFFFFFF]
        array = np.frombuffer((number * length).from_address(buffer[DATA]), number)
        out.append(array if len(shape) == 1 else array.reshape(shape))
    return out


def _answer(frame: Any) -> bool:
    """Answer what XLA asks by an extension; return whether it has asked for something."""
    extension = _words(frame[EXTENSION], _METADATA + 1)
    if extension[1] & 0xFFFFFFFF != _ASKS_FOR_VERSION:
        return False
    asked = extension[_METADATA] + 8 * (_VERSION_IN_METADATA + _VERSION_NUMBERS)
    own = frame[API] + 8 * (_VERSION_IN_API + _VERSION_NUMBERS)
    ctypes.memmove(asked, own, 8)
    return True


def _handle(address: int) -> int | None:
    """Do what a call frame asks for; return nothing, or an error of XLA's."""
    try:
        asked = has_extension(address) and _answer(_words(address, _FRAME_WORDS))
        if not asked:
            function = _functions[function_of(address)]
            column = np.empty(function.size)
            if not (take_column(address, column) and give_column(address, function.one(column))):
                frame = _words(address, _FRAME_WORDS)
                function.many(
                    _arrays(frame[ARGUMENTS], frame[ARGUMENT_LIST]),
                    _arrays(frame[RESULTS], frame[RESULT_LIST]),
                )
    except BaseException as error:  # nothing of Python's may pass through C
        invalid = isinstance(error, ValueError)
        text = str(error) if invalid else f"{type(error).__name__}: {error}"
        given = _ErrorArguments(
            ctypes.sizeof(_ErrorArguments),
            None,
            text.encode(errors="replace"),
            _INVALID if invalid else _INTERNAL,
        )
        made: int | None = _make_error(
            _words(_words(address, _FRAME_WORDS)[API], _MAKE_ERROR + 1)[_MAKE_ERROR]
        )(ctypes.byref(given))
        return made
    return None


_HANDLER = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)(_handle)
