"""Checked, read-only arrays: the form in which numbers enter and leave pinred."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from math import isfinite
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InputError, ShapeError
from .plain_names import brief

Array: TypeAlias = NDArray[np.float64]

_LARGEST = float(np.finfo(float).max)


def as_floats(value: ArrayLike, what: str) -> Array:
    """Return `value` as an array of floats.  Raises ShapeError naming `what`."""
    try:
        array = np.asarray(value)
        if array.dtype.kind in "bcmMSU":  # NumPy reads numbers in texts, truths and durations
            raise TypeError
        return np.asarray(array, dtype=float)
    except OverflowError:
        raise ShapeError(f"{what} must be numbers of at most {_LARGEST:.1e}") from None
    except (TypeError, ValueError):
        raise ShapeError(f"{what} must be numbers, got {brief(value)}") from None


def entries_of(value: Any) -> list[Any] | None:
    """Return the entries of a list of any kind; None for text, mappings and what has no entries."""
    if isinstance(value, (str, bytes, Mapping)):
        return None
    try:
        return list(value)
    except TypeError:
        return None


def dimensions(value: Any) -> int:
    """Return how many axes an array has, or would have; −1 for lists that no array can hold."""
    try:
        return np.ndim(value)
    except (TypeError, ValueError):
        return -1


def vector(value: ArrayLike, size: int, what: str, labels: Sequence[str] = ()) -> Array:
    """Return `value` as a finite vector of length `size`.

    `what` names the argument in the message and `labels`, if given, its entries.
    Raises ShapeError if the length is wrong or an entry is not finite.
    """
    array = as_floats(value, what)
    if array.shape != (size,):
        raise ShapeError(f"{what} must have shape ({size},){_hint(labels)}, got {array.shape}")
    return _finite(array, what, labels)


def vectors(value: ArrayLike, size: int, what: str, labels: Sequence[str] = ()) -> Array:
    """Return `value` as finite vectors of length `size`, (..., size); errors as of `vector`."""
    array = as_floats(value, what)
    if array.shape[-1:] != (size,):
        raise ShapeError(f"{what} must have shape (..., {size}){_hint(labels)}, got {array.shape}")
    return _finite(array, what, labels)


def _hint(labels: Sequence[str]) -> str:
    return f" ({', '.join(labels)})" if 0 < len(labels) <= 12 else ""


def _finite(array: Array, what: str, labels: Sequence[str]) -> Array:
    """Return an array whose last axis has labels.  Raises ShapeError unless it is finite."""
    finite = np.isfinite(array)
    if not finite.all():
        index = tuple(int(i) for i in np.argwhere(~finite)[0])
        label = f" ({labels[index[-1]]})" if labels else ""
        entry = index[0] if len(index) == 1 else index
        raise ShapeError(f"{what} must be finite, but entry {entry}{label} is {array[index]}")
    return array


def positive(value: float, what: str) -> float:
    """Return `value` as a finite float above zero.  Raises InputError naming `what`."""
    try:
        if np.asarray(value).dtype.kind == "b":
            raise TypeError
        number = float(value)
    except OverflowError:
        raise InputError(f"{what} must be at most {_LARGEST:.1e}") from None
    except (TypeError, ValueError):
        raise InputError(f"{what} must be a number, got {brief(value)}") from None
    if not (isfinite(number) and number > 0):
        raise InputError(f"{what} must be finite and above zero, got {number:g}")
    return number


def read_only(array: Array) -> Array:
    """Mark `array` as read-only and return it."""
    array.flags.writeable = False
    return array


def freeze(value: Any) -> None:
    """Mark every array among the fields of a dataclass as read-only."""
    for entry in fields(value):
        array = getattr(value, entry.name)
        if isinstance(array, np.ndarray):
            array.flags.writeable = False


def whole(value: object, what: str, least: int = 1) -> int:
    """Return a whole number, not below `least`.  Raises InputError naming `what`."""
    try:
        number = int(value)  # type: ignore[call-overload]
        if not isinstance(value, bool) and number == value and number >= least:
            return int(number)
    except (TypeError, ValueError, OverflowError):
        pass
    raise InputError(f"{what} must be a whole number from {least} on, got {brief(value)}")
