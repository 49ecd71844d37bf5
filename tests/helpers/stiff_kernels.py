"""Compile vector fields with derivatives for tests of stiff integrators."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
from numba import types

_NUMBERS: Any = types.CPointer(types.float64)  # type: ignore[no-untyped-call]

_alive: list[Any] = []  # keeps compiled functions from being freed


def kernels(rate: Callable[..., None], slope: Callable[..., None]) -> tuple[int, Callable[[], int]]:
    """Compile a vector field and its derivative along eight tangent directions.

    Returns the address of the field, and a function that returns the address of the derivative.
    """
    field: Any = numba.cfunc(types.void(_NUMBERS, _NUMBERS, _NUMBERS))(rate)
    derivative: Any = numba.cfunc(types.void(_NUMBERS, _NUMBERS, _NUMBERS, _NUMBERS))(slope)
    _alive.append((field, derivative))
    return field.address, lambda: int(derivative.address)
