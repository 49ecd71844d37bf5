"""Predicates of numbers and arrays of numbers, for the checks of arguments."""

from __future__ import annotations

from numbers import Integral, Real
from typing import Any

import numpy as np

_LARGEST = int(np.finfo(float).max)
_COMMON = frozenset({int, float, np.float64, np.int64})  # frequent types of entries of lists


def is_number(value: Any) -> bool:
    """Return whether a value is a real number that a float can represent."""
    if type(value) is int:
        return -_LARGEST < value < _LARGEST
    if isinstance(value, np.ndarray):
        return value.ndim == 0 and value.dtype.kind in "fiu"
    # np.timedelta64 counts as a whole number, and without a unit it converts to a float.
    if not isinstance(value, Real) or isinstance(value, (bool, np.timedelta64)):
        return False
    try:
        float(value)
    except OverflowError:
        return False
    return True


def is_whole(value: Any) -> bool:
    """Return whether a value is a whole number."""
    if isinstance(value, np.ndarray):
        return value.ndim == 0 and value.dtype.kind in "iu"
    return isinstance(value, Integral) and not isinstance(value, (bool, np.timedelta64))


def are_numbers(value: Any) -> bool:
    """Return whether a value is an array, a number, or a nested list of arrays and numbers."""
    if isinstance(value, (list, tuple)):
        return _COMMON.issuperset(map(type, value)) or all(map(are_numbers, value))
    if isinstance(value, np.ndarray):
        if value.dtype.kind == "O":
            return all(map(_is_entry, value.flat))
        return value.dtype.kind not in "mMSUV"
    if isinstance(value, np.generic):
        return is_number(value)
    return is_number(value) or isinstance(value, range) or hasattr(type(value), "__array__")


def _is_entry(value: Any) -> bool:
    """Return whether an entry of an array of objects is a number or an expression."""
    is_expression = hasattr(type(value), "__array__") and not isinstance(value, np.generic)
    return is_expression or is_number(value)


def has_fixed_entries(value: Any) -> bool:
    """Return whether the type of numbers, or the dtype of an array, decides that it is admitted."""
    if isinstance(value, np.ndarray):
        return bool(value.dtype.kind != "O")
    return not isinstance(value, (list, tuple, int))
