"""Operations that all steppers perform on the rows that contain states."""

from __future__ import annotations

from math import sqrt

import numpy as np

from ...common.arrays import Array
from .compiling import compiled, inlined
from .run_record import AGAIN, Run

Y, NEW = 0, 1  # rows of `work`: the state at the start of a step, and at its end
WIDTH = 4  # numbers in a vector; rows are padded with zeros to a multiple of it

# Size by which errors of a quaternion's entries are measured. Rotation by an angle changes the
# quaternion by half of it, and the mean over four entries halves it again, so that the tolerance
# applies to the angle.
TURN = 0.25


def padded_rows(count: int, n: int) -> Array:
    """Return `count` rows of zeros for n numbers each, padded to whole vectors."""
    return np.zeros((count, -(-n // WIDTH) * WIDTH))


@inlined
def in_quaternion(i: int, quaternion: int) -> bool:
    """Return whether entry i is one of the quaternion's four."""
    return 0 <= i - quaternion < 4 and quaternion >= 0


@inlined
def entry_size(y: Array, i: int, quaternion: int) -> float:
    """Return the size of entry i by which its error is measured."""
    size: float = abs(y[i])
    if in_quaternion(i, quaternion):
        size = TURN
    return size


@compiled
def unit_alone(y: Array, quaternion: int) -> float:
    """Normalise the quaternion of y, −1 for none; return the factor."""
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
    """Normalise the quaternion of y, −1 for none, and scale its rate by the same factor.

    A kernel uses the direction of the quaternion only. Therefore the quaternion's rate is
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


@inlined
def keep_state(run: Run, work: Array, t: float, end_times: Array, end_states: Array) -> None:
    """Store step end number run.steps: the time, and the state before normalisation.

    Args:
        run: Registers of the run.
        work: Rows of the stepper.
        t: Time [s].
        end_times: Times of the step ends, (K,) [s].
        end_states: Their states, (K, n …).
    """
    if run.keep:
        k, row = run.steps, NEW if run.begun else Y
        end_times[k] = t
        for i in range(run.n):
            end_states[k, i] = work[row, i]


@inlined
def copy_an_end(run: Run, work: Array, time: float, t_new: float, out: Array) -> bool:
    """Copy the state to `out` if a time is the start or the end of the current step.

    Args:
        run: Registers of the run.
        work: Rows of the stepper.
        time: Time of the requested state [s].
        t_new: End of the step [s].
        out: State, (n,).
    Returns:
        Whether the state was copied.
    """
    if run.t < time < t_new:
        return False
    row = Y if time <= run.t else NEW
    for i in range(run.n):
        out[i] = work[row, i]
    return True


@inlined
def reject_step(run: Run, h: float) -> int:
    """Reject a trial step and plan a shorter one, of length h, with new Newton factors."""
    run.rejected += 1
    run.again = 1
    run.h, run.factored = h, 0.0
    return AGAIN


@compiled
def first_step_by_rate(run: Run, y: Array, rate: Array, lanes: int, fraction: float) -> float:
    """Return a first step: a fraction of the time in which the state changes by its size.

    Args:
        run: Registers of the run.
        y: Initial state, (n,).
        rate: Its rates, one every `lanes` numbers.
        lanes: Distance between the rates of two entries.
        fraction: Fraction of the time.
    Returns:
        The step [s].
    """
    square = 0.0
    for i in range(run.n):
        scale = run.atol / run.rtol + entry_size(y, i, run.quaternion)
        square += (rate[i * lanes] / scale) ** 2
    longest: float = min(run.t_end, run.max_step)
    return min(longest, fraction * sqrt(run.n / square)) if square > 0.0 else longest
