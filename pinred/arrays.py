"""Checked, read-only arrays: the form in which numbers enter and leave pinred."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InputError, ShapeError

Array: TypeAlias = NDArray[np.float64]


def as_floats(value: ArrayLike, what: str) -> Array:
    """Return `value` as an array of floats.  Raises ShapeError naming `what`."""
    try:
        if np.iscomplexobj(value):
            raise TypeError
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise ShapeError(f"{what} must be numbers, got {value!r}") from None


def vector(value: ArrayLike, size: int, what: str, labels: Sequence[str] = ()) -> Array:
    """Return `value` as a finite vector of length `size`.

    `what` names the argument in the message and `labels`, if given, its entries.
    Raises ShapeError if the length is wrong or an entry is not finite.
    """
    array = as_floats(value, what)
    if array.shape != (size,):
        hint = f" ({', '.join(labels)})" if 0 < len(labels) <= 12 else ""
        raise ShapeError(f"{what} must have shape ({size},){hint}, got {array.shape}")
    if not np.isfinite(array).all():
        i = int(np.argmin(np.isfinite(array)))
        label = f" ({labels[i]})" if labels else ""
        raise ShapeError(f"{what} must be finite, but entry {i}{label} is {array[i]}")
    return array


def positive(value: float, what: str) -> float:
    """Return `value` as a finite float above zero.  Raises InputError naming `what`."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise InputError(f"{what} must be a number, got {value!r}") from None
    if not (np.isfinite(number) and number > 0):
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
