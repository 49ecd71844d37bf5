"""Conversion of the arguments of group operations to arrays of floats, with the right length."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np

from ..common.argument_kinds import checks_arguments
from ..common.arrays import as_floats
from ..common.errors import ShapeError

_FLOAT = np.dtype(float)
# Length of the last axis in a group, by the name of the argument.
_LENGTHS: dict[str, Callable[[Any], int]] = {
    **dict.fromkeys(("g", "h"), lambda group: group.size),
    **dict.fromkeys(("xi", "eta", "mu"), lambda group: group.dim),
    "attitude": lambda group: group.size - group.linear,
    "v": lambda group: group.linear,
    "c": lambda _: 3,
}


def convert_arguments(group: type) -> None:
    """Let the operations of a class of groups accept lists and arrays of any numbers.

    Arguments that are not numbers, or of another length, raise an error that names them.

    Args:
        group: The class, whose methods are changed in place.
    """
    for name, member in list(vars(group).items()):
        if inspect.isfunction(member) and not getattr(member, "__isabstractmethod__", False):
            parameters = list(inspect.signature(member).parameters)[1:]
            if parameters and set(parameters) <= {*_LENGTHS, "matrix"}:
                setattr(group, name, _on_arrays(member, parameters))
    checks_arguments(group)


def _on_arrays(method: Callable[..., Any], names: list[str]) -> Callable[..., Any]:
    @wraps(method)
    def call(group: Any, *values: Any) -> Any:
        return method(group, *(_array(group, *pair) for pair in zip(names, values, strict=True)))

    return call


def _array(group: Any, name: str, value: Any) -> Any:
    """Return an argument as an array of floats, and check the length of its last axes."""
    if not isinstance(value, np.ndarray) or value.dtype != _FLOAT:
        value = as_floats(value, name)
    length = _LENGTHS.get(name)
    shape = group.matrix(group.identity()).shape if length is None else (length(group),)
    if value.shape[-len(shape) :] != shape:
        expected = ", ".join(map(str, ("...", *shape)))
        raise ShapeError(f"{name} must have shape ({expected}), got {value.shape}")
    return value
