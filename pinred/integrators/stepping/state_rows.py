"""The work rows that contain the states at both ends of a step, and operations on states.

Steps with fixed lengths are repeated with tangents and covectors: `Replay` and what follows it.
"""

from __future__ import annotations

from math import sqrt
from typing import TypeAlias

import numpy as np

from ...common.arrays import Array
from .compiling import compiled, inlined

Y, NEW = 0, 1  # rows of `work`: the state at the start of a step, and at its end
WIDTH = 4  # number of floats in a vector; rows are padded with zeros to a multiple of it

# The quaternions (x, y, z, w) of a state: index in y of the first entry of the first quaternion,
# and number of consecutive quaternions; (0, 0) for none. This is a plain tuple, because numba takes
# microseconds to find the type of a named tuple.
Quaternions: TypeAlias = tuple[int, int]

# Scale of the errors of a quaternion's entries. A rotation by an angle changes the quaternion by
# half the angle, and the root mean square over four entries halves it again. With this scale, the
# tolerance applies to the angle.
TURN = 0.25


def padded_rows(count: int, n: int) -> Array:
    """Return `count` rows of zeros for n numbers each, padded to whole vectors."""
    return np.zeros((count, -(-n // WIDTH) * WIDTH))


@inlined
def in_quaternion(i: int, quaternions: Quaternions) -> bool:
    """Return whether entry i is an entry of a quaternion."""
    first, count = quaternions
    return first <= i < first + 4 * count


@inlined
def first_entries(quaternions: Quaternions) -> range:
    """Return the index of the first entry of each quaternion."""
    first, count = quaternions
    return range(first, first + 4 * count, 4)


@inlined
def entry_size(y: Array, i: int, quaternions: Quaternions) -> float:
    """Return the scale of entry i with which its error is compared."""
    size: float = abs(y[i])
    if in_quaternion(i, quaternions):
        size = TURN
    return size


@inlined
def inverse_length(y: Array, first: int) -> float:
    """Return the reciprocal of the length of the quaternion whose first entry is y[first]."""
    square = 0.0
    for i in range(first, first + 4):
        square += y[i] * y[i]
    return 1.0 / sqrt(square)


@compiled
def unit_alone(y: Array, quaternions: Quaternions) -> None:
    """Normalise the quaternions of y."""
    for first in first_entries(quaternions):
        factor = inverse_length(y, first)
        for i in range(first, first + 4):
            y[i] *= factor


@compiled
def unit(y: Array, rate: Array, quaternions: Quaternions) -> None:
    """Normalise the quaternions of y, and scale the rate of each by the same factor.

    A kernel uses only the directions of the quaternions. Therefore the rate of a quaternion is
    proportional to its length, and the other rates do not change.
    """
    for first in first_entries(quaternions):
        factor = inverse_length(y, first)
        for i in range(first, first + 4):
            y[i] *= factor
            rate[i] *= factor


@compiled
def first_not_finite(row: Array, n: int) -> int:
    """Return the index of the first of n entries that is not finite, −1 if all are finite."""
    total = 0.0
    for i in range(n):
        total += row[i] - row[i]  # NaN for infinities and NaN, else zero
    if total == 0.0:
        return -1
    for i in range(n):
        if row[i] - row[i] != 0.0:
            return i
    return -1


@compiled
def copy_row(source: Array, out: Array) -> None:
    """Copy a row."""
    for k in range(out.shape[0]):
        out[k] = source[k]


@compiled
def add_row(source: Array, out: Array) -> None:
    """Add a row to another."""
    for k in range(out.shape[0]):
        out[k] += source[k]


# These values are plain tuples: numba takes microseconds to find the type of a named tuple.

# The steps of a run: address of the kernel; quaternions; parameters, (p,); times of the step ends,
# (K,) [s]; sorted report times, (T,) [s].
Replay: TypeAlias = tuple[int, Quaternions, Array, Array, Array]

# A state and tangent directions, and their reports. N rows contain one direction each, or SEEDS
# directions with consecutive values for each entry: state, (n,), and directions of the state,
# (N, n …), both changed in place; directions of the parameters, (N, p …); states at the report
# times, (T, n), and their tangents, (T, N, n …), both output.
Tangents: TypeAlias = tuple[Array, Array, Array, Array, Array]

# A covector that is propagated back over stored steps: states at the step ends, (K, n), or
# (K, n + …) with the stages of each step; covector (n,) at the last step end, changed to the
# covector at the first; covectors of the states at the report times, (T, n), overwritten;
# derivative with respect to the parameters, (p,), to which the result is added; workspace for the
# output of the adjoint kernel, (n + p,) per state.
Cotangents: TypeAlias = tuple[Array, Array, Array, Array, Array]


@compiled
def across(y: Array, quaternions: Quaternions, v: Array, width: int) -> None:
    """Apply the derivative of `unit_alone` at y, a symmetric matrix, to tangents or covectors v.

    Args:
        y: State before normalisation.
        quaternions: Quaternions of the state.
        v: Tangents or covectors, (n width,), changed in place.
        width: Number of consecutive values in v for each entry of the state.
    """
    for first in first_entries(quaternions):
        factor = inverse_length(y, first)
        for lane in range(width):
            radial = 0.0
            for k in range(first, first + 4):
                radial += y[k] * factor * v[k * width + lane]
            for k in range(first, first + 4):
                across_unit = v[k * width + lane] - y[k] * factor * radial
                v[k * width + lane] = across_unit * factor


@compiled
def normalise_with(y: Array, quaternions: Quaternions, along: Array, width: int) -> None:
    """Normalise the quaternions of y and, with the derivative, all rows of tangents in `along`."""
    for row in range(along.shape[0]):
        across(y, quaternions, along[row], width)
    unit_alone(y, quaternions)


@compiled
def report(tangents: Tangents, r: int, quaternions: Quaternions, width: int) -> None:
    """Write the state and its tangents as report r, with normalised quaternions."""
    y, along, _, out, out_along = tangents
    copy_row(y, out[r])
    for row in range(along.shape[0]):
        copy_row(along[row], out_along[r, row])
    normalise_with(out[r], quaternions, out_along[r], width)
