"""The work rows that contain the states at both ends of a step, and operations on states."""

from __future__ import annotations

from math import sqrt

import numpy as np

from ...common.arrays import Array
from .compiling import compiled, inlined

Y, NEW = 0, 1  # rows of `work`: the state at the start of a step, and at its end
WIDTH = 4  # number of floats in a vector; rows are padded with zeros to a multiple of it

# Scale of the errors of a quaternion's entries. A rotation by an angle changes the quaternion by
# half the angle, and the root mean square over four entries halves it again. With this scale, the
# tolerance applies to the angle.
TURN = 0.25


def padded_rows(count: int, n: int) -> Array:
    """Return `count` rows of zeros for n numbers each, padded to whole vectors."""
    return np.zeros((count, -(-n // WIDTH) * WIDTH))


@inlined
def in_quaternion(i: int, quaternion: int) -> bool:
    """Return whether entry i is one of the quaternion's four entries."""
    return 0 <= i - quaternion < 4 and quaternion >= 0


@inlined
def entry_size(y: Array, i: int, quaternion: int) -> float:
    """Return the scale of entry i with which its error is compared."""
    size: float = abs(y[i])
    if in_quaternion(i, quaternion):
        size = TURN
    return size


@compiled
def unit_alone(y: Array, quaternion: int) -> float:
    """Normalise the quaternion of y; return the factor. quaternion: first index, −1 for none."""
    if quaternion < 0:
        return 1.0
    square = 0.0
    for i in range(quaternion, quaternion + 4):
        square += y[i] * y[i]
    factor = 1.0 / sqrt(square)
    for i in range(quaternion, quaternion + 4):
        y[i] *= factor
    return factor


@compiled
def unit(y: Array, rate: Array, quaternion: int) -> None:
    """Normalise the quaternion of y, and scale its rate by the same factor.

    `quaternion` is the index of its first entry, −1 for none.

    A kernel uses only the direction of the quaternion. Therefore the quaternion's rate is
    proportional to its length, and the other rates do not change.
    """
    if quaternion >= 0:
        factor = unit_alone(y, quaternion)
        for i in range(quaternion, quaternion + 4):
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
