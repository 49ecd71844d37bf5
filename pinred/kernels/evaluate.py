"""Compiled calls of kernels and of their derivatives: at many states, along many directions."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..common.arrays import Array
from ..integrators.stepping.compiling import compiled
from ..integrators.stepping.intrinsics import (
    SEEDS,
    call,
    call_adjoint,
    call_slopes,
    call_tangent,
    from_lanes,
    to_lanes,
)


def evaluate(
    address: int, parameters: Array, y: Array, size: int, out: Array | None = None
) -> Array:
    """Evaluate a kernel at several states, with common or separate parameters.

    Args:
        address: Address of the machine code.
        parameters: Parameters, (p,) for all states, or (T, p) for each state.
        y: States, (T, k).
        size: Number of outputs of the kernel.
        out: Array (T, size) for the values; a new one if None.
    Returns:
        (T, size): the values.
    """
    values = np.empty((len(y), size)) if out is None else out
    rows = np.ascontiguousarray(np.atleast_2d(parameters))
    stride = 0 if parameters.ndim == 1 else 1  # rows between the parameters of successive states
    _evaluate_all(address, rows, np.ascontiguousarray(y), values, stride)
    return values


def evaluate_row(address: int, parameters: Array, y: Array, values: Array) -> None:
    """Evaluate a kernel at one state, without the checks and copies of `evaluate`.

    Args:
        address: Address of the machine code.
        parameters: Parameters, (1, p).
        y: State, (1, k).
        values: Outputs, (1, size), filled.
    """
    _evaluate_all(address, parameters, y, values, 0)


def evaluate_runs(
    address: int, constants: Array, y: Array, times: Array, entries: int, values: Array
) -> None:
    """Evaluate the outputs of N runs at common times.

    Args:
        address: Address of the machine code.
        constants: Constants of each run, (N, p).
        y: States, (N, T, k).
        times: Times, (T,), the last input of the code [s]; empty if the states contain the time.
        entries: Number of entries of a state that are inputs of the code.
        values: Outputs, (N, T, size), filled.
    """
    row = np.zeros(entries + 1)
    _evaluate_runs(
        address, np.ascontiguousarray(constants), np.ascontiguousarray(y), times, entries, row,
        values,
    )  # fmt: skip


@compiled
def _evaluate_runs(
    address: int,
    constants: Array,
    y: Array,
    times: Array,
    entries: int,
    row: Array,
    values: Array,
) -> None:
    has_times = len(times) > 0
    for i in range(y.shape[0]):
        for j in range(y.shape[1]):
            for k in range(entries):
                row[k] = y[i, j, k]
            if has_times:
                row[entries] = times[j]
            call(address, row, constants[i], values[i, j])


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
def _evaluate_all(address: int, parameters: Array, y: Array, out: Array, stride: int) -> None:
    for k in range(len(y)):
        call(address, y[k], parameters[k * stride], out[k])


@compiled
def call_value(address: int, a: Array, b: Array, out: Array) -> None:
    """Evaluate machine code (a, b, result) into `out`.

    Args:
        address: Address of the machine code.
        a: First column.
        b: Second column.
        out: Receives the result.
    """
    call(address, a, b, out)


@compiled
def repeat_adjoint(
    address: int, a: Array, b: Array, covector: Array, out: Array, count: int
) -> None:
    """Evaluate an adjoint repeatedly, for timing.

    Args:
        address: Address of the machine code.
        a: First column.
        b: Second column.
        covector: λ.
        out: Receives the derivatives.
        count: Number of evaluations.
    """
    for _ in range(count):
        call_adjoint(address, a, b, covector, out)


@compiled
def call_forward(address: int, a: Array, b: Array, da: Array, db: Array, out: Array) -> None:
    """Evaluate a tangent (a, b, δa, δb, result) into `out`."""
    call_slopes(address, a, b, da, db, out)


@compiled
def call_at_each(address: int, a: Array, b: Array, da: Array, db: Array, out: Array) -> None:
    """Compute derivatives along batches of SEEDS directions at each of several points.

    Args:
        address: Address of the machine code.
        a: First columns, (N, …).
        b: Second columns, (N, …).
        da: Directions of a, (N or 1, batches, … SEEDS).
        db: Directions of b, (N or 1, batches, … SEEDS).
        out: Receives the derivatives, (N, batches, size SEEDS).
    """
    for i in range(out.shape[0]):
        row_a, row_b = i % da.shape[0], i % db.shape[0]
        for j in range(out.shape[1]):
            call_slopes(address, a[i], b[i], da[row_a, j], db[row_b, j], out[i, j])


@compiled
def call_in_batches(
    address: int,
    a: Array,
    b: Array,
    da: Array,
    db: Array,
    seeds_a: Array,
    seeds_b: Array,
    lanes: Array,
    out: Array,
) -> None:
    """Compute derivatives (size, N) along directions (…, N), SEEDS directions at once."""
    to_lanes(da, seeds_a)
    to_lanes(db, seeds_b)
    for k in range(lanes.shape[0]):
        call_slopes(address, a, b, seeds_a[k], seeds_b[k], lanes[k])
    from_lanes(lanes, out)


@compiled
def call_reverse(address: int, a: Array, b: Array, covector: Array, out: Array) -> None:
    """Evaluate an adjoint (a, b, covector, result) into `out`."""
    call_adjoint(address, a, b, covector, out)


WIDTH = SEEDS  # number of directions that one call evaluates
_ENTRIES = 2**15  # numbers per block, few enough to fit into the CPU's cache


def columns_at(address: int, x: Array, size: int, m: int) -> Iterator[tuple[slice, Array]]:
    """Yield, block by block, the outputs at shapes x, (N, nx), for all unit joint rates u.

    Args:
        address: Address of machine code (x, none, u) → outputs (size,), compiled for WIDTH
            directions.
        x: Shapes, (N, nx) [rad | m].
        size: Number of outputs.
        m: Number of joint rates.
    Yields:
        The slice of x in this block, and its outputs, (count, max(m, 1), size).  Row k of the
        second axis belongs to the unit rate k.  Without joints, its only row belongs
        to the empty rate u = ().
    """
    N, columns = len(x), max(m, 1)
    count = max(1, _ENTRIES // (columns * size))
    none, rates, lanes = np.zeros(1), np.zeros((m, WIDTH)), np.empty((size, WIDTH))
    for start in range(0, N, count):
        chunk = slice(start, start + count)
        shapes = np.ascontiguousarray(x[chunk])
        outputs = np.empty((len(shapes), columns, size))
        _evaluate(address, none, shapes, rates, lanes, outputs)
        yield chunk, outputs


@compiled
def _evaluate(
    address: int, none: Array, x: Array, rates: Array, lanes: Array, outputs: Array
) -> None:
    joints, columns = len(rates), outputs.shape[1]
    for first in range(0, columns, WIDTH):
        width = min(WIDTH, columns - first)
        rates[:] = 0.0
        for lane in range(min(width, joints - first)):
            rates[first + lane, lane] = 1.0
        for k in range(len(x)):
            call_tangent(address, x[k], none, rates, lanes)
            for lane in range(width):
                for i in range(outputs.shape[2]):
                    outputs[k, first + lane, i] = lanes[i, lane]
