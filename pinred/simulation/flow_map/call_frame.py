"""A call frame of XLA as compiled code reads it: numbers in, numbers out, without arrays between.

A frame is a structure of C, read as words of eight bytes; see `xla_call`, which reads those of many
columns.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import types

from ...common.arrays import Array
from ...integrators.stepping.compiling import compiled, make_intrinsic

# Places of words.  Of a frame, its arguments, results and attributes: how many there are, and where
# the list of addresses begins.  Then those of a buffer.
EXTENSION, API = 1, 2
ARGUMENTS, ARGUMENT_LIST, RESULTS, RESULT_LIST, ATTRIBUTES = 7, 9, 12, 14, 20
TYPE, DATA, RANK, DIMS = 2, 3, 4, 5
FLOAT, DOUBLE = 11, 12  # XLA's types of data
SCALAR_VALUE = 1


def _memory(kind: Any, pointed: Any) -> tuple[Any, Any]:
    """Return load(address) and store(address, value) for numbers of a kind."""

    @make_intrinsic
    def load(typing: Any, address: Any) -> Any:  # noqa: ARG001
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001
            return builder.load(builder.inttoptr(arguments[0], pointed.as_pointer()))

        return kind(types.int64), generate

    @make_intrinsic
    def store(typing: Any, address: Any, value: Any) -> Any:  # noqa: ARG001
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001
            builder.store(arguments[1], builder.inttoptr(arguments[0], pointed.as_pointer()))
            return context.get_dummy_value()

        return types.void(types.int64, kind), generate

    return load, store


_word, _ = _memory(types.int64, ir.IntType(64))
_double, _set_double = _memory(types.float64, ir.DoubleType())
_float, _set_float = _memory(types.float32, ir.FloatType())


@compiled
def has_extension(frame: int) -> bool:
    """Return whether XLA may ask for something beside a call."""
    asks: bool = _word(frame + 8 * EXTENSION) != 0
    return asks


@compiled
def function_of(frame: int) -> int:
    """Return the number of the function that a call means, its only attribute."""
    scalar = _word(_word(frame + 8 * ATTRIBUTES))
    value: int = _word(_word(scalar + 8 * SCALAR_VALUE))
    return value


@compiled
def take_column(frame: int, out: Array) -> bool:
    """Fill out with the arguments one after another; return whether they are vectors that fit."""
    fits: bool = _pass(frame, ARGUMENTS, ARGUMENT_LIST, out, True)
    return fits


@compiled
def give_column(frame: int, out: Array) -> bool:
    """Fill the results, one after another, from out; return whether they are vectors that fit."""
    fits: bool = _pass(frame, RESULTS, RESULT_LIST, out, False)
    return fits


@compiled
def _pass(frame: int, count: int, where: int, numbers: Array, take: bool) -> bool:
    """Move numbers between the buffers of a frame and an array."""
    buffers, total = _word(frame + 8 * where), 0
    for k in range(_word(frame + 8 * count)):
        buffer = _word(buffers + 8 * k)
        if _word(buffer + 8 * RANK) != 1:
            return False
        size = _word(_word(buffer + 8 * DIMS))
        kind, data = _word(buffer + 8 * TYPE) & 0xFFFFFFFF, _word(buffer + 8 * DATA)
        if total + size > numbers.shape[0] or (kind != FLOAT and kind != DOUBLE):
            return False
        for i in range(size):
            if kind == DOUBLE and take:
                numbers[total + i] = _double(data + 8 * i)
            elif kind == DOUBLE:
                _set_double(data + 8 * i, numbers[total + i])
            elif take:
                numbers[total + i] = _float(data + 4 * i)
            else:
                _set_float(data + 4 * i, numbers[total + i])
        total += size
    fits: bool = total == numbers.shape[0]
    return fits
