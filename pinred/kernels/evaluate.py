"""Evaluation of a kernel at many states."""

from __future__ import annotations

import numpy as np

from ..common.arrays import Array
from ..integrators.stepping.compiling import compiled
from ..integrators.stepping.kernel_call import call


def evaluate(address: int, parameters: Array, y: Array, size: int) -> Array:
    """Return a kernel's values, (T, size), at states y (T, k) and parameters (p,)."""
    out = np.empty((len(y), size))
    _rows(address, np.ascontiguousarray(parameters), np.ascontiguousarray(y), out)
    return out


def evaluate_each(address: int, y: Array, parameters: Array, size: int) -> Array:
    """Return a kernel's values, (N, size), at states y (N, k), each with parameters of its own."""
    out = np.empty((len(y), size))
    _pairs(address, np.ascontiguousarray(y), np.ascontiguousarray(parameters), out)
    return out


def repeat(address: int, parameters: Array, y: Array, count: int) -> None:
    """Evaluate a kernel `count` times at one state y (k,), to be timed."""
    _again(address, parameters, y, np.empty(len(y)), count)


@compiled
def _again(address: int, parameters: Array, y: Array, out: Array, count: int) -> None:
    for _ in range(count):
        call(address, y, parameters, out)


@compiled
def _rows(address: int, parameters: Array, y: Array, out: Array) -> None:
    for k in range(len(y)):
        call(address, y[k], parameters, out[k])


@compiled
def _pairs(address: int, y: Array, parameters: Array, out: Array) -> None:
    for k in range(len(y)):
        call(address, y[k], parameters[k], out[k])
