"""Keys of forces and of motions, which differ whenever a result may differ.

Numbers, tables of numbers and arrays are compared by value, because they can change in place.  They
are compared with their types: True and 1 are equal, but only one of them is a valid number.
Functions, Parameters and signals cannot change, so keys contain the objects themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from types import BuiltinFunctionType, FunctionType, MethodType
from typing import Any

import numpy as np

from ..common.default_marker import Default
from ..common.parameter import Parameter, VectorParameter
from .actuation import Actuation
from .controller import Controller
from .force import Force, Limit
from .kinds import Damper, Friction, Spring
from .signals import Attitude, Expression, Signal
from .signals.tabulated import Table

_PACKAGE = f"{__name__.partition('.')[0]}."
PLAIN = frozenset({float, int, Default, np.float64, np.int64, str, bool, type(None)})
_FUNCTIONS = (FunctionType, MethodType, BuiltinFunctionType)


class NotKeyedError(Exception):
    """A value has no key, because it may change in place."""


def _key_of_array(array: np.ndarray) -> Hashable:
    """Return the key of an array of numbers; raise NotKeyedError for arrays of objects."""
    if array.dtype.hasobject:
        raise NotKeyedError
    return array.dtype.str, array.shape, array.tobytes()


def key_of(value: Any, of_table: Callable[[Table], Hashable] | None = None) -> Hashable:
    """Return the key of a value in a force or in the option `prescribed`.

    Args:
        value: Number, text, mapping, array, function, Parameter, signal, attitude or limit.
        of_table: Function that returns the key of a table; None to compare tables by identity.
            With this function, functions in the value have no key: they may use other variables.
    Returns:
        The key, which keeps the objects in it alive.
    Raises:
        NotKeyedError: The value may change in place.
    """
    kind = type(value)
    if kind in PLAIN:
        return kind, value
    if of_table is not None and isinstance(value, Table):
        return of_table(value)
    if kind in (Parameter, VectorParameter, Expression):
        return kind, value
    if isinstance(value, _FUNCTIONS) and of_table is None:
        return kind, value
    if kind is dict:
        return kind, tuple([(key_of(k), key_of(entry, of_table)) for k, entry in value.items()])
    if kind in (list, tuple):
        return kind, tuple([key_of(entry, of_table) for entry in value])
    if kind is np.ndarray:
        return _key_of_array(value)
    if kind in (Limit, Attitude):
        return kind, key_of(vars(value), of_table)
    if isinstance(value, Signal) and kind.__module__.startswith(_PACKAGE):
        return kind, _Same(value)
    raise NotKeyedError


def key_of_force(force: Force) -> Hashable:
    """Return the key of a force.

    Springs, dampers, friction and actuators are compared by value.  Other forces are compared by
    identity, because their functions may use variables that change, and by their numbers.

    Args:
        force: The force.
    Returns:
        The key, which keeps the force alive.
    Raises:
        NotKeyedError: The force may change in place, as a controller does.
    """
    kind = type(force)
    if kind in (Spring, Damper, Friction):
        return kind, force
    if isinstance(force, Actuation):
        return kind, tuple((actuator, key_of(control)) for actuator, control in force.controls)
    if kind is Controller or not kind.__module__.startswith(_PACKAGE):
        raise NotKeyedError
    return _Same(force), key_of(vars(force))


class _Same:
    """A key that is equal for the same object only, and keeps it alive."""

    __slots__ = ("_value",)

    def __init__(self, value: object) -> None:
        self._value = value

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and self._value is other._value

    def __hash__(self) -> int:
        return id(self._value)
