"""A function of arrays as XLA calls it: its foreign function interface, read without a compiler.

XLA gives a handler the address of a call frame, a structure of C (xla/ffi/api/c_api.h, which
jaxlib brings along; version 0 of it).  It is read as words of eight bytes; the places below are
those of the fields that count, and what newer versions append is not looked at.  One handler
serves everything: an attribute of the call, a number, says which function is meant.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from itertools import count
from typing import Any

import numpy as np

from ...common.memo import once_for_all

TARGET = "pinred_function"

Function = Callable[[Sequence[Any], Sequence[Any]], None]  # of inputs, and of outputs to be filled

# Places of words.  Of a frame, its arguments, results and attributes: how many there are, and where
# the list of addresses begins.
_EXTENSION, _API = 1, 2
_ARGUMENTS, _RESULTS, _ATTRIBUTES = (7, 9), (12, 14), 20
_FRAME_WORDS = 21
_TYPE, _DATA, _RANK, _DIMS, _BUFFER_WORDS = 2, 3, 4, 5, 6
_SCALAR_VALUE = 1
# An extension of type 1 asks for the version; its metadata, the whole of which begins with a
# version, too, as the API does after its own two words.
_ASKS_FOR_VERSION, _METADATA = 1, 3
_VERSION_IN_METADATA, _VERSION_IN_API, _VERSION_NUMBERS = 1, 2, 2
_MAKE_ERROR = 6
_INVALID, _INTERNAL = 3, 13  # codes of errors
_FLOATS: dict[int, Any] = {11: ctypes.c_float, 12: ctypes.c_double}  # by XLA's type of data


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


def _arrays(frame: Any, places: tuple[int, int]) -> list[Any]:
    """Return the buffers of a frame as arrays, in their places."""
    size, out = frame[places[0]], []
    for address in _words(frame[places[1]], size):
        buffer = _words(address, _BUFFER_WORDS)
        shape, length = _words(buffer[_DIMS], buffer[_RANK])[:], 1
        for each in shape:
            length *= each
        number = _FLOATS[buffer[_TYPE] & 0xFFFFFFFF]
        array = np.frombuffer((number * length).from_address(buffer[_DATA]), number)
        out.append(array if len(shape) == 1 else array.reshape(shape))
    return out


def _handle(address: int) -> int | None:
    """Do what a call frame asks for; return nothing, or an error of XLA's."""
    frame = _words(address, _FRAME_WORDS)
    if frame[_EXTENSION]:
        extension = _words(frame[_EXTENSION], _METADATA + 1)
        if extension[1] & 0xFFFFFFFF == _ASKS_FOR_VERSION:
            asked = extension[_METADATA] + 8 * (_VERSION_IN_METADATA + _VERSION_NUMBERS)
            own = frame[_API] + 8 * (_VERSION_IN_API + _VERSION_NUMBERS)
            ctypes.memmove(asked, own, 8)
            return None
    try:
        inputs, outputs = _arrays(frame, _ARGUMENTS), _arrays(frame, _RESULTS)
        scalar = _words(_words(frame[_ATTRIBUTES], 1)[0], 2)
        _functions[_words(scalar[_SCALAR_VALUE], 1)[0]](inputs, outputs)
    except BaseException as error:  # nothing of Python's may pass through C
        invalid = isinstance(error, ValueError)
        text = str(error) if invalid else f"{type(error).__name__}: {error}"
        given = _ErrorArguments(
            ctypes.sizeof(_ErrorArguments),
            None,
            text.encode(errors="replace"),
            _INVALID if invalid else _INTERNAL,
        )
        made: int | None = _make_error(_words(frame[_API], _MAKE_ERROR + 1)[_MAKE_ERROR])(
            ctypes.byref(given)
        )
        return made
    return None


_HANDLER = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)(_handle)
