"""Kernels of stiff systems."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
from numba import types

_NUMBERS: Any = types.CPointer(types.float64)  # type: ignore[no-untyped-call]

_alive: list[Any] = []


def kernels(rate: Callable[..., None], slope: Callable[..., None]) -> tuple[int, Callable[[], int]]:
    """Compile a vector field and its derivative, which takes eight directions."""
    first: Any = numba.cfunc(types.void(_NUMBERS, _NUMBERS, _NUMBERS))(rate)
    second: Any = numba.cfunc(types.void(_NUMBERS, _NUMBERS, _NUMBERS, _NUMBERS))(slope)
    _alive.append((first, second))
    return first.address, lambda: int(second.address)
