"""Gauss–Legendre collocation with steps of one length: symplectic, of any even order to 16.

On the canonical form, with the quaternion as Cayley–Klein lift of the momentum, the map keeps
the Poisson structure and the Casimirs: see docs/accuracy.md.  Reports between the ends of
steps are steps of their own, of the same order.
"""

from __future__ import annotations

import numpy as np

from ..arrays import Array
from .implicit import (
    CARRY,
    GUESS,
    INFO,
    NEW,
    NEXT_CARRY,
    OLD,
    ROUND_OFF,
    SCALE,
    SUB,
    WITHIN,
    L,
    Y,
    finish,
    guess,
    iterate,
    prepare_guess,
    start_evenly,
)
from .implicit import DIVERGED as NO_SOLUTION
from .kernel import compiled
from .run import (
    BEFORE,
    BEGUN,
    BUDGET,
    DIVERGED,
    DONE,
    ENTRY,
    EVALUATIONS,
    FULL,
    KEEP,
    LANES,
    NEXT,
    NOT_FINITE,
    PAUSED,
    QUATERNION,
    STAGES,
    STEPS,
    T_END,
    TOTAL,
    Counts,
    H,
    N,
    T,
    first_not_finite,
    keep,
    unit_alone,
)

_SLACK = 1e-6  # of the largest number: an iteration that stops further off has not converged


@compiled
def advance(
    address: int,
    params: Array,
    real: Array,
    count: Counts,
    work: Array,
    times: Array,
    out: Array,
    knots_t: Array,
    knots_y: Array,
) -> int:
    """Integrate until the end, a pause, a full store of knots or a failure; return which.

    Arguments as in dop853.advance; the kernel at `address` evaluates all stages at once.
    """
    n, lanes, stages = count[N], count[LANES], count[STAGES]
    if not count[BEGUN]:
        unit_alone(work[Y], count[QUATERNION])
        keep(count, work[Y], 0.0, knots_t, knots_y)
        count[BEGUN] = 1
    pause = count[EVALUATIONS] + count[BUDGET]
    while count[STEPS] < count[TOTAL]:
        if count[EVALUATIONS] >= pause:
            return PAUSED
        if count[KEEP] and count[STEPS] + 1 >= knots_t.shape[0]:
            return FULL
        k = count[STEPS] + 1
        t_new = real[T_END] if k == count[TOTAL] else k * real[H]
        # The steps are of one length to the last bit: round-off in the clock does not count.
        h = real[H]
        if count[STEPS] == 0:
            start_evenly(address, params, work, n, lanes, L, h)
            count[EVALUATIONS] += stages
            count[ENTRY] = first_not_finite(work[L], n * lanes)
            if count[ENTRY] >= 0:
                count[ENTRY] //= lanes
                return NOT_FINITE
            prepare_guess(work, lanes, stages, GUESS, 1.0, 1.0)
        else:
            guess(work, n, lanes, GUESS, OLD, L)
        turns = solve(address, params, work, n, lanes, L, h)
        if turns == NO_SOLUTION:
            count[ENTRY] = entry_of(work, n, lanes)
            return NOT_FINITE if count[ENTRY] >= 0 else DIVERGED
        count[EVALUATIONS] += turns * stages
        finish(work, n, lanes, L)
        report(address, params, real, count, work, times, out, t_new)
        count[STEPS] += 1
        keep(count, work[NEW], t_new, knots_t, knots_y)
        for i in range(n):
            work[Y, i] = work[NEW, i]
            work[CARRY, i] = work[NEXT_CARRY, i]
        for i in range(n * lanes):
            work[OLD, i] = work[L, i]
        real[T] = t_new
        real[BEFORE] = h
    return DONE


@compiled
def solve(address: int, params: Array, work: Array, n: int, lanes: int, row: int, h: float) -> int:
    """Solve a step to round-off; return the turns, or NO_SOLUTION."""
    largest = 0.0
    for i in range(n):
        largest = max(largest, abs(work[Y, i]))
        for j in range(lanes):
            largest = max(largest, abs(work[row, i * lanes + j]))
    inverse = 1.0 / largest if largest > 0.0 else 0.0
    for i in range(n):
        work[SCALE, i] = inverse
    work[INFO, 0] = _SLACK
    return iterate(address, params, work, n, lanes, row, h, ROUND_OFF)


@compiled
def entry_of(work: Array, n: int, lanes: int) -> int:
    """Return which number is not finite in the stages of a step, −1 for none."""
    entry = first_not_finite(work[L], n * lanes)
    return entry // lanes if entry >= 0 else -1


@compiled
def report(
    address: int,
    params: Array,
    real: Array,
    count: Counts,
    work: Array,
    times: Array,
    out: Array,
    t_new: float,
) -> None:
    """Write the states at the times that lie in a step from real[T] to t_new."""
    while count[NEXT] < times.shape[0] and times[count[NEXT]] <= t_new:
        j = count[NEXT]
        time, t = times[j], real[T]
        if t < time < t_new:
            ratio = (time - t) / (t_new - t)
            prepare_guess(work, count[LANES], count[STAGES], WITHIN, 0.0, ratio)
            guess(work, count[N], count[LANES], WITHIN, L, SUB)
        state(address, params, count, work, time, t, t_new, out[j])
        count[NEXT] += 1


@compiled
def state(
    address: int,
    params: Array,
    count: Counts,
    work: Array,
    time: float,
    t: float,
    t_new: float,
    out: Array,
) -> None:
    """Write the state at a time in the step from t to t_new, (n,), its quaternion of length 1.

    Between the ends it is that of a shorter step from the begin, with a first guess in SUB.
    """
    n, lanes = count[N], count[LANES]
    if time <= t or time >= t_new:
        row = Y if time <= t else NEW
        for i in range(n):
            out[i] = work[row, i]
    else:
        h = time - t
        turns = solve(address, params, work, n, lanes, SUB, h)
        count[EVALUATIONS] += turns * count[STAGES]
        for i in range(n):
            total = 0.0
            for j in range(lanes):
                total += work[SUB, i * lanes + j]
            out[i] = work[Y, i] + total
            if turns == NO_SOLUTION:
                out[i] = np.nan
    unit_alone(out, count[QUATERNION])


@compiled
def recall(
    address: int,
    params: Array,
    count: Counts,
    work: Array,
    times: Array,
    out: Array,
    knots_t: Array,
    knots_y: Array,
) -> None:
    """Fill out (T, n) with the states at sorted times (T,) by steps from the knots before them."""
    n = count[N]
    k, begun = 0, -1
    for j in range(times.shape[0]):
        while k + 1 < knots_t.shape[0] - 1 and times[j] > knots_t[k + 1]:
            k += 1
        if begun != k:
            begun = k
            for i in range(n):
                work[Y, i] = knots_y[k, i]
                work[NEW, i] = knots_y[k + 1, i]
        time, t = times[j], knots_t[k]
        if t < time < knots_t[k + 1]:
            start_evenly(address, params, work, n, count[LANES], SUB, time - t)
        state(address, params, count, work, time, t, knots_t[k + 1], out[j])
