"""Conversion of arguments to arrays of floats, read-only arrays, finite differences, packed values.

Packed values are nested values as JSON text and binary buffers: None, booleans, numbers, texts,
bytes, arrays, and lists and dictionaries of them.  Floats and arrays keep all bits.  Lists of
similar values become columns, so that long lists are small.  Reading executes nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from math import isfinite
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InputError, ShapeError
from .names import brief

Array: TypeAlias = NDArray[np.float64]

_FLOATS = np.dtype(float)
_MOST_LABELS = 12  # largest number of entries that a message names
_SHORT = 32  # length up to which a list of floats is checked faster than an array
_LARGEST = float(np.finfo(float).max)


def as_floats(value: ArrayLike, what: str) -> Array:
    """Convert a value to an array of floats.

    Args:
        value: Numbers of any shape.
        what: Name of the argument, for messages.
    Returns:
        The array; it may share memory with `value`.
    Raises:
        ShapeError: The value is not an array of numbers, or a number is too large.
    """
    try:
        array = np.asarray(value)
        # Text, booleans and durations are rejected below, because NumPy would convert them.
        if array.dtype.kind not in "bcmMSU":
            return np.asarray(array, dtype=float)
    except OverflowError:
        raise ShapeError(f"{what} must be numbers of at most {_LARGEST:.1e}") from None
    except (TypeError, ValueError):
        pass
    raise ShapeError(f"{what} must be numbers, got {brief(value)}")


def entries_of(value: Any) -> list[Any] | None:
    """Return the entries of any iterable as a list; None for text, mappings and non-iterables."""
    if isinstance(value, (str, bytes, Mapping)):
        return None
    try:
        return list(value)
    except TypeError:
        return None


def dimensions(value: Any) -> int:
    """Return the number of axes that a value has as an array; −1 for ragged lists."""
    try:
        return np.ndim(value)
    except (TypeError, ValueError):
        return -1


def vector(value: ArrayLike, size: int, what: str, labels: Sequence[str] = ()) -> Array:
    """Convert a value to a finite vector.

    Args:
        value: Numbers, (size,).
        size: Required length.
        what: Name of the argument, for messages.
        labels: Names of the entries, for messages.
    Returns:
        (size,): the vector.
    Raises:
        ShapeError: The length is wrong, or an entry is not finite.
    """
    array = (
        value if type(value) is np.ndarray and value.dtype is _FLOATS else as_floats(value, what)
    )
    if array.shape != (size,):
        shape = str(len(array)) if array.ndim == 1 else f"shape {array.shape}"
        if size == len(labels) <= _MOST_LABELS:
            numbers = "1 number" if size == 1 else f"{size} numbers"
            raise ShapeError(f"{what}: expected {numbers}: {', '.join(labels)}, got {shape}")
        raise ShapeError(f"{what} must have shape ({size},), got {array.shape}")
    return _finite(array, what, labels)


def vector_or_zero(value: ArrayLike, size: int, what: str, labels: Sequence[str] = ()) -> Array:
    """Convert a value to a finite vector, where the number 0 stands for the zero vector.

    Args:
        value: Numbers, (size,); 0; or a single number if the size is 1.
        size: Required length.
        what: Name of the argument, for messages.
        labels: Names of the entries, for messages.
    Returns:
        (size,): the vector.
    Raises:
        ShapeError: The length is wrong, or an entry is not finite.
    """
    is_number = dimensions(value) == 0 and (size == 1 or value == 0)
    entries: Any = [value] * size if is_number else value
    return vector(entries, size, what, labels)


def vectors(value: ArrayLike, size: int, what: str, labels: Sequence[str] = ()) -> Array:
    """Convert a value to finite vectors along its last axis.

    Args:
        value: Numbers, (..., size).
        size: Required length of the last axis.
        what: Name of the argument, for messages.
        labels: Names of the entries, for messages.
    Returns:
        (..., size): the vectors.
    Raises:
        ShapeError: The last axis has the wrong length, or an entry is not finite.
    """
    array = as_floats(value, what)
    if array.shape[-1:] != (size,):
        raise ShapeError(f"{what} must have shape (..., {size}){_hint(labels)}, got {array.shape}")
    return _finite(array, what, labels)


def rows(value: ArrayLike, size: int, what: str) -> Array:
    """Convert a value to rows of numbers, which need not be finite.

    Args:
        value: Numbers, (N, size).
        size: Required length of a row.
        what: Name of the argument, for messages.
    Returns:
        (N, size): the rows.
    Raises:
        ShapeError: The value has another shape, or is not an array of numbers.
    """
    array = as_floats(value, what)
    if array.ndim != 2 or array.shape[1] != size:
        raise ShapeError(f"{what} must have shape (N, {size}), got {array.shape}")
    return array


def _hint(labels: Sequence[str]) -> str:
    return f" ({', '.join(labels)})" if 0 < len(labels) <= _MOST_LABELS else ""


def is_finite(array: Array) -> bool:
    """Return whether all entries of an array are finite; faster than NumPy for short vectors."""
    if array.ndim == 1 and array.size <= _SHORT:
        return all(map(isfinite, array.tolist()))
    return bool(np.isfinite(array).all())


def _finite(array: Array, what: str, labels: Sequence[str]) -> Array:
    """Return a finite array unchanged.  Raises ShapeError that names the entry at fault."""
    if not is_finite(array):
        finite = np.isfinite(array)
        index = tuple(int(i) for i in np.argwhere(~finite)[0])
        label = f" ({labels[index[-1]]})" if labels else ""
        entry = index[0] if len(index) == 1 else index
        raise ShapeError(f"{what} must be finite, but entry {entry}{label} is {array[index]}")
    return array


def positive(value: float, what: str) -> float:
    """Convert a value to a finite, positive float.

    Args:
        value: A number.
        what: Name of the argument, for messages.
    Returns:
        The float.
    Raises:
        InputError: The value is not a finite, positive number.
    """
    number = None
    try:
        if np.asarray(value).dtype.kind != "b":
            number = float(value)
    except OverflowError:
        raise InputError(f"{what} must be at most {_LARGEST:.1e}") from None
    except (TypeError, ValueError):
        pass
    if number is None:
        raise InputError(f"{what} must be a number, got {brief(value)}")
    if not (isfinite(number) and number > 0):
        raise InputError(f"{what} must be finite and above zero, got {number:g}")
    return number


def read_only(array: Array) -> Array:
    """Mark `array` as read-only and return it."""
    array.flags.writeable = False
    return array


def copied(value: Any) -> Any:
    """Copy an array or list, or a mapping with all arrays and lists in it.

    Args:
        value: Any value.
    Returns:
        A read-only array, a list or a dict; other values unchanged.
    """
    if isinstance(value, np.ndarray):
        return read_only(value.copy())
    if isinstance(value, list):
        return value.copy()
    if isinstance(value, Mapping):
        return {name: copied(entry) for name, entry in value.items()}
    return value


def freeze(value: Any) -> None:
    """Mark all array fields of a dataclass instance as read-only."""
    for entry in fields(value):
        array = getattr(value, entry.name)
        if isinstance(array, np.ndarray):
            array.flags.writeable = False


class FrozenArrays:
    """Base of dataclasses whose array fields are read-only."""

    def __post_init__(self) -> None:
        freeze(self)


def whole(value: object, what: str, least: int = 1, most: int | None = None) -> int:
    """Convert a value to an integer.

    Args:
        value: A number.
        what: Name of the argument, for messages.
        least: Smallest allowed value.
        most: Largest allowed value; None if there is none.
    Returns:
        The integer.
    Raises:
        InputError: The value is not an integer, or is not in these limits.
    """
    try:
        number = int(value)  # type: ignore[call-overload]
        is_allowed = number >= least and (most is None or number <= most)
        if not isinstance(value, bool) and number == value and is_allowed:
            return int(number)
    except (TypeError, ValueError, OverflowError):
        pass
    limits = f"of at least {least}" if most is None else f"from {least} to {most}"
    raise InputError(f"{what} must be a whole number {limits}, got {brief(value)}")


_WEIGHTS = ((1, 45.0 / 60.0), (2, -9.0 / 60.0), (3, 1.0 / 60.0))  # (offset, weight) of order 6


def central_differences(function: Callable[[Array], Array], x: Array, step: float) -> Array:
    """Compute the derivative of a function by central differences of order 6.

    Args:
        function: Function (m,) → (k,).
        x: Argument, (m,).
        step: Step of each entry of x.
    Returns:
        (k, m): the derivative.
    """
    derivative = np.zeros((len(x), function(x).size))
    for column, unit in zip(derivative, step * np.eye(len(x)), strict=True):
        for k, weight in _WEIGHTS:
            column += weight / step * (function(x + k * unit) - function(x - k * unit))
    return derivative.T


def pack(value: Any) -> tuple[Any, list[bytes | memoryview]]:
    """Return a value as data for JSON, and the buffers to which the data refers.

    Args:
        value: The value.
    Returns:
        Data and buffers, as `unpack` expects them.
    """
    buffers: list[bytes | memoryview] = []
    return _pack(value, buffers), buffers


def unpack(data: Any, buffers: Sequence[bytes | memoryview]) -> Any:
    """Return the value of data and buffers that `pack` returned; arrays are writable copies."""
    if not isinstance(data, dict):
        return data
    ((form, content),) = data.items()
    match form:
        case "bytes":
            return bytes(buffers[content])
        case "array":
            dtype, shape, k = content
            return np.frombuffer(bytearray(buffers[k]), dtype).reshape(shape)
        case "dict":
            return {key: unpack(entry, buffers) for key, entry in content.items()}
        case "list":
            return [unpack(entry, buffers) for entry in content]
        case "floats":
            return unpack(content, buffers).tolist()
        case "arrays":
            shapes, flat = (unpack(entry, buffers) for entry in content)
            ends = np.cumsum(shapes.prod(axis=1))
            pieces = np.split(flat, ends[:-1])
            return [piece.reshape(shape) for piece, shape in zip(pieces, shapes, strict=True)]
        case "columns":
            columns = {key: unpack(entry, buffers) for key, entry in content.items()}
            return [
                dict(zip(columns, entries, strict=True))
                for entries in zip(*columns.values(), strict=True)
            ]
    raise InputError(f"expected a kind of packed values, got {form!r}")


def _pack(value: Any, buffers: list[bytes | memoryview]) -> Any:
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, bytes):
        buffers.append(value)
        return {"bytes": len(buffers) - 1}
    if isinstance(value, np.ndarray):
        array = np.ascontiguousarray(value)
        buffers.append(array.reshape(-1).view(np.uint8).data)
        return {"array": [array.dtype.str, list(value.shape), len(buffers) - 1]}
    if isinstance(value, Mapping):
        return {"dict": {key: _pack(entry, buffers) for key, entry in value.items()}}
    return _pack_list(list(value), buffers)


def _pack_list(values: list[Any], buffers: list[bytes | memoryview]) -> Any:
    """Return a list as data, in columns if its entries are of one kind."""
    kinds = {type(value) for value in values}
    if kinds == {float}:
        return {"floats": _pack(np.array(values), buffers)}
    if kinds == {np.ndarray} and len({(array.dtype, array.ndim) for array in values}) == 1:
        shapes = np.array([array.shape for array in values], dtype=np.int64)
        flat = np.concatenate([array.reshape(-1) for array in values])
        return {"arrays": [_pack(shapes, buffers), _pack(flat, buffers)]}
    if kinds == {dict} and values[0] and len({tuple(value) for value in values}) == 1:
        columns = {key: [value[key] for value in values] for key in values[0]}
        return {"columns": {key: _pack_list(column, buffers) for key, column in columns.items()}}
    return {"list": [_pack(value, buffers) for value in values]}
