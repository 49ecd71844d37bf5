"""Types of the arguments of compiled functions, with names by which their code is found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np


@dataclass(frozen=True)
class NumberType:
    """The type of a Python number.

    Attributes:
        kind: int, float or bool.
    """

    kind: type

    def __str__(self) -> str:
        return {int: "int64", float: "float64", bool: "bool"}[self.kind]


@dataclass(frozen=True)
class ArrayType:
    """The type of a NumPy array, which may be read-only.

    Attributes:
        dtype: Type of its entries.
        ndim: Number of axes.
        layout: C for contiguous rows, F for contiguous columns, A for others.
    """

    dtype: np.dtype[Any]
    ndim: int
    layout: str

    def __str__(self) -> str:
        return f"array({_entry_name(self.dtype)}, {self.ndim}d, {self.layout})"


@dataclass(frozen=True)
class TupleType:
    """The type of a tuple, or of a named tuple.

    Attributes:
        kind: The class.
        items: Types of the items.
    """

    kind: type
    items: tuple[ArgumentType, ...]

    def __str__(self) -> str:
        if len(set(self.items)) == 1:
            name = "UniTuple" if self.kind is tuple else self.kind.__name__
            return f"{name}({self.items[0]} x {len(self.items)})"
        name = "Tuple" if self.kind is tuple else self.kind.__name__
        return f"{name}({', '.join(map(str, self.items))})"


# The dtypes seen first; copies of them, such as those of unpickled arrays, are other objects.
_DTYPES: dict[Any, np.dtype[Any]] = {np.dtype(kind): np.dtype(kind) for kind in (float, np.int64)}

ArgumentType: TypeAlias = NumberType | ArrayType | TupleType


def argument_type(value: Any) -> ArgumentType | None:
    """Return the type of an argument.

    Args:
        value: The argument.
    Returns:
        The type, or None if compiled functions take no such arguments.
    """
    kind = type(value)
    if kind in (int, float, bool):
        return NumberType(kind)
    if kind is np.ndarray:
        return _array_type(value)
    if kind is tuple or (issubclass(kind, tuple) and hasattr(kind, "_fields")):
        items = tuple(map(argument_type, value))
        known = tuple(item for item in items if item is not None)
        return TupleType(kind, known) if known and len(known) == len(items) else None
    return None


def plain_value(value: Any) -> Any:
    """Return an argument with numbers of Python, and with arrays whose equal dtypes are identical.

    Args:
        value: An argument.
    Returns:
        The argument, or an equal one that shares its memory.
    """
    kind = type(value)
    if kind in (np.float64, np.int64, np.bool_):
        return value.item()
    if kind in (np.ndarray, np.memmap):
        dtype = _DTYPES.setdefault(value.dtype, value.dtype)
        same = dtype is value.dtype and kind is np.ndarray
        return value if same else value.view(dtype, np.ndarray)
    if kind is tuple:
        return tuple(map(plain_value, value))
    if issubclass(kind, tuple) and hasattr(kind, "_fields"):
        return kind(*map(plain_value, value))
    return value


def _array_type(array: Any) -> ArrayType | None:
    flags = array.flags
    if not (flags.aligned and _entry_name(array.dtype)):
        return None
    layout = "C" if flags.c_contiguous else "F" if flags.f_contiguous else "A"
    return ArrayType(array.dtype, array.ndim, layout)


def _entry_name(dtype: np.dtype[Any]) -> str:
    """Return the name of the type of entries, "" if compiled functions take no such arrays."""
    if dtype.kind in "biuf":  # numbers and truth values
        return str(dtype) if dtype.isnative else ""
    if dtype.fields is None or not dtype.isalignedstruct:
        return ""
    fields = sorted(dtype.fields.items(), key=lambda field: field[1][1])
    if not all(_entry_name(kind) for _, (kind, *_) in fields):
        return ""
    described = (
        f"{name}[type={_entry_name(kind)};offset={offset}]" for name, (kind, offset, *_) in fields
    )
    return f"Record({','.join(described)};{dtype.itemsize};True)"
