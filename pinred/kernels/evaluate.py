"""Evaluation of machine code at many states."""

from __future__ import annotations

import numpy as np

from ..common.arrays import Array
from ..integrators.stepping.compiling import compiled
from ..integrators.stepping.kernel_call import call


def evaluate(address: int, parameters: Array, y: Array, size: int) -> Array:
    """Evaluate a kernel at several states with common parameters.

    Args:
        address: Address of the machine code.
        parameters: Parameters, (p,).
        y: States, (T, k).
        size: Number of values at each state.
    Returns:
        (T, size): the values.
    """
    values = np.empty((len(y), size))
    _evaluate_all(address, np.ascontiguousarray(parameters), np.ascontiguousarray(y), values)
    return values


def evaluate_each(address: int, y: Array, parameters: Array, size: int) -> Array:
    """Evaluate a kernel at several states with separate parameters.

    Args:
        address: Address of the machine code.
        y: States, (N, k).
        parameters: Parameters of each state, (N, p).
        size: Number of values at each state.
    Returns:
        (N, size): the values.
    """
    values = np.empty((len(y), size))
    _evaluate_pairs(address, np.ascontiguousarray(y), np.ascontiguousarray(parameters), values)
    return values


def repeat(address: int, parameters: Array, y: Array, count: int) -> None:
    """Evaluate a kernel repeatedly at one state, for timing.

    Args:
        address: Address of the machine code.
        parameters: Parameters, (p,).
        y: State, (k,).
        count: Number of evaluations.
    """
    _repeat(address, parameters, y, np.empty(len(y)), count)


@compiled
def _repeat(address: int, parameters: Array, y: Array, out: Array, count: int) -> None:
    for _ in range(count):
        call(address, y, parameters, out)


@compiled
def _evaluate_all(address: int, parameters: Array, y: Array, out: Array) -> None:
    for k in range(len(y)):
        call(address, y[k], parameters, out[k])


@compiled
def _evaluate_pairs(address: int, y: Array, parameters: Array, out: Array) -> None:
    for k in range(len(y)):
        call(address, y[k], parameters[k], out[k])
