"""Operations of all steppers on the rows that hold states."""

from __future__ import annotations

from math import sqrt

import numpy as np

from ...common.arrays import Array
from .compiling import compiled, woven
from .run_record import Run

Y, NEW = 0, 1  # rows of `work`: the state at the begin of a step, and at its end
WIDTH = 4  # numbers in a vector; rows are padded with zeros to a multiple of it

# What a quaternion's entries are measured by: a turn by an angle changes it by half of that,
# and the mean over four entries halves it again, so that the tolerance is that of the angle.
TURN = 0.25


def padded_rows(count: int, n: int) -> Array:
    """Return so many rows of zeros for n numbers each."""
    return np.zeros((count, -(-n // WIDTH) * WIDTH))


@woven
def in_quaternion(i: int, quaternion: int) -> bool:
    """Return whether entry i is one of the quaternion's four."""
    return 0 <= i - quaternion < 4 and quaternion >= 0


@compiled
def unit_alone(y: Array, quaternion: int) -> float:
    """Bring the quaternion of y to length one and return the factor; −1 for none."""
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
    """Bring the quaternion of y to length one, and its rate with it; −1 for none.

    A kernel takes the direction of the quaternion, so that the rate of the quaternion has
    its length as a factor and the other rates do not change.
    """
    if quaternion >= 0:
        factor = unit_alone(y, quaternion)
        for i in range(quaternion, quaternion + 4):
            rate[i] *= factor


@compiled
def first_not_finite(row: Array, n: int) -> int:
    """Return the index of the first of n entries that is not finite, −1 if all are."""
    total = 0.0
    for i in range(n):
        total += row[i] - row[i]  # NaN for infinities and NaN, else zero
    if total == 0.0:
        return -1
    for i in range(n):
        if row[i] - row[i] != 0.0:
            return i
    return -1


@woven
def keep_state(run: Run, work: Array, t: float, knots_t: Array, knots_y: Array) -> None:
    """Write down a knot, after run.steps steps: the time and the state that a step has left."""
    if run.keep:
        k, row = run.steps, NEW if run.begun else Y
        knots_t[k] = t
        for i in range(run.n):
            knots_y[k, i] = work[row, i]


@woven
def copy_an_end(run: Run, work: Array, time: float, t_new: float, out: Array) -> bool:
    """Write the state of a step that ends at t_new to out (n,) if a time is an end of it.

    Return whether it is.
    """
    if run.t < time < t_new:
        return False
    row = Y if time <= run.t else NEW
    for i in range(run.n):
        out[i] = work[row, i]
    return True
