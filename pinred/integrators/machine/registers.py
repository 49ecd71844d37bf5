"""The state of a run, held in arrays so that it can stop and go on, and its small helpers.

real (12,) and count (21,) are indexed by the names below; a stepper's `advance` works on
them and returns one of the codes.
"""

from __future__ import annotations

from math import sqrt
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array
from .kernel_call import compiled

Counts: TypeAlias = NDArray[np.int64]

# Entries of `real`: time, next step, end time, longest step, tolerances, the step before.
# Of Newton's method: the step that has been factored; by what it converges, and what it then
# leaves of a change; by what a step is cut where it fails.  The error of the step before.
(
    T, H, T_END, MAX_STEP, RTOL, ATOL, BEFORE, FACTORED, CONTRACTION, CONVERGENCE, CUT, ERROR,
) = range(12)  # fmt: skip
REALS = 12

# Entries of `count`: numbers in the state; first of the quaternion's four or −1; accepted
# and rejected steps; evaluations; next time to report; whether the run has begun; whether
# the last trial was rejected; limit on trials; entry that was not finite or −1; whether
# knots are kept; evaluations before a pause; number of steps if it is known beforehand;
# stages that are lanes of one evaluation, and lanes; the kernel of the derivative or 0;
# whether the Jacobian is that of the state; how implicit steps are solved, and how many more
# by Newton's method; positions, and constant momenta, as drive.Canonical has them.
(
    N, QUATERNION, STEPS, REJECTED, EVALUATIONS, NEXT, BEGUN, AGAIN, MAX_STEPS, ENTRY, KEEP,
    BUDGET, TOTAL, STAGES, LANES, TANGENT, FRESH,
    SOLVER, REMAINING, PAIRS, SPIN,
) = range(21)  # fmt: skip
COUNTS = 21

# What `advance` returns.
# WANTED: the kernel of the derivative.
DONE, PAUSED, FULL, WANTED, UNDERFLOW, NOT_FINITE, TOO_MANY, DIVERGED = range(8)


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


@compiled
def keep(count: Counts, row: Array, t: float, knots_t: Array, knots_y: Array) -> None:
    """Write down a knot: time t and state row, after count[STEPS] steps."""
    if count[KEEP]:
        k = count[STEPS]
        knots_t[k] = t
        for i in range(count[N]):
            knots_y[k, i] = row[i]


@compiled
def step_at(time: float, k: int, knots_t: Array) -> int:
    """Return the step within which a time lies, from the k-th on; its end belongs to it."""
    while k + 1 < knots_t.shape[0] - 1 and time > knots_t[k + 1]:
        k += 1
    return k
