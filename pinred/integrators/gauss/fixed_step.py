"""Gauss–Legendre collocation with steps of one length: symplectic, of any even order to 16.

On the canonical form, with the quaternion as Cayley–Klein lift of the momentum, the map keeps
the Poisson structure and the Casimirs: see docs/integrators.md.  Reports between the ends of
steps are steps of their own, of the same order.
"""

from __future__ import annotations

import numpy as np

from ...common.arrays import Array
from ..machine.kernel_call import SEEDS, compiled
from ..machine.registers import (
    BEFORE,
    BEGUN,
    BUDGET,
    DIVERGED,
    DONE,
    ENTRY,
    EVALUATIONS,
    FACTORED,
    FULL,
    KEEP,
    LANES,
    NEXT,
    NOT_FINITE,
    PAUSED,
    QUATERNION,
    REALS,
    REMAINING,
    SOLVER,
    STAGES,
    STEPS,
    T_END,
    TANGENT,
    TOTAL,
    WANTED,
    Counts,
    H,
    N,
    T,
    first_not_finite,
    keep,
    step_at,
    unit_alone,
)
from ..methods import AUTO, FIXED_POINT, NEWTON
from .newton import MAIN, prepare, refine
from .newton import SUB as OTHER
from .stages import (
    CARRY,
    GUESS,
    INFO,
    NEW,
    NEXT_CARRY,
    OLD,
    RATE,
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
from .stages import DIVERGED as NO_SOLUTION

_STAY = 64  # steps by Newton's method before fixed-point iteration is tried again
_PIECES = 64  # at most, of a step up to a report
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
    limit = _turns_worth_newton(n, stages)
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
        auto = count[SOLVER] == AUTO
        newton = count[SOLVER] == NEWTON or (auto and count[REMAINING] > 0)
        if newton and count[TANGENT] == 0:
            return WANTED
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
        if newton:
            turns = solve_by_newton(
                address, params, real, count, work, L, MAIN, abs(h - real[FACTORED]) > 0.0, h
            )
        else:
            turns = solve(address, params, work, n, lanes, L, h)
        if turns == NO_SOLUTION and auto and not newton:
            count[EVALUATIONS] += stages
            count[REMAINING] = _STAY  # and begin the step anew
            continue
        if turns == NO_SOLUTION:
            row = RATE if newton else L
            count[ENTRY] = first_not_finite(work[row], n * lanes)
            if count[ENTRY] >= 0:
                count[ENTRY] //= lanes
                return NOT_FINITE
            return DIVERGED
        if auto and not newton and turns > limit:
            count[REMAINING] = _STAY
        elif count[REMAINING] > 0:
            count[REMAINING] -= 1
        count[EVALUATIONS] += turns * stages
        finish(work, n, lanes, L)
        reported = report(address, params, real, count, work, times, out, t_new)
        if reported != DONE:
            return reported
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
    """Solve a step to round-off by fixed-point iteration; return the turns, or NO_SOLUTION."""
    _measure(work, n, lanes, row)
    work[INFO, 0] = _SLACK
    return iterate(address, params, work, n, lanes, row, h, ROUND_OFF)


@compiled
def solve_by_newton(
    address: int, params: Array, real: Array, count: Counts, work: Array, row: int, which: int,
    fresh: bool, h: float,
) -> int:  # fmt: skip
    """Solve a step to round-off by Newton's method; return the turns, or NO_SOLUTION.

    which, fresh: whose factors, and whether they have to be made.
    """
    n, lanes, stages = count[N], count[LANES], count[STAGES]
    _measure(work, n, lanes, row)
    made = (n + SEEDS - 1) // SEEDS
    if fresh:
        count[EVALUATIONS] += made
        if not prepare(count[TANGENT], params, work, n, stages, which, h):
            return NO_SOLUTION
    turns = refine(address, count[TANGENT], params, work, n, lanes, stages, row, which, fresh, h)
    if which == MAIN:
        real[FACTORED] = 0.0 if turns == NO_SOLUTION else h
    if turns != NO_SOLUTION and turns < 0:
        count[EVALUATIONS] += made
        turns = -turns
    return turns


@compiled
def _turns_worth_newton(n: int, stages: int) -> int:
    """Return about how many turns of the fixed point take as long as Newton's method.

    Measured on the bundled robots.  So many are rare: Newton's method is for steps at which
    fixed-point iteration hardly converges, or does not.
    """
    return 40 + n * ((stages + 1) // 2)


@compiled
def _measure(work: Array, n: int, lanes: int, row: int) -> None:
    """Fill SCALE with the inverse of the largest number."""
    largest = 0.0
    for i in range(n):
        largest = max(largest, abs(work[Y, i]))
        for j in range(lanes):
            largest = max(largest, abs(work[row, i * lanes + j]))
    inverse = 1.0 / largest if largest > 0.0 else 0.0
    for i in range(n):
        work[SCALE, i] = inverse


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
) -> int:
    """Write the states at the times that lie in a step from real[T] to t_new; return DONE.

    If one has no solution, no more of them, and DIVERGED, or WANTED where there is no derivative
    yet for Newton's method.
    """
    while count[NEXT] < times.shape[0] and times[count[NEXT]] <= t_new:
        j = count[NEXT]
        time, t = times[j], real[T]
        if t < time < t_new:
            ratio = (time - t) / (t_new - t)
            prepare_guess(work, count[LANES], count[STAGES], WITHIN, 0.0, ratio)
            guess(work, count[N], count[LANES], WITHIN, L, SUB)
        if not state(address, params, real, count, work, time, t, t_new, out[j]):
            return WANTED if count[SOLVER] == AUTO and count[TANGENT] == 0 else DIVERGED
        count[NEXT] += 1
    return DONE


@compiled
def state(
    address: int,
    params: Array,
    real: Array,
    count: Counts,
    work: Array,
    time: float,
    t: float,
    t_new: float,
    out: Array,
) -> bool:
    """Write the state at a time in the step from t to t_new, (n,), its quaternion of length 1.

    Between the ends it is that of a shorter step from the begin, with a first guess in SUB;
    False, and NaN, if that has no solution.
    """
    n, lanes = count[N], count[LANES]
    turns = 1
    if time <= t or time >= t_new:
        row = Y if time <= t else NEW
        for i in range(n):
            out[i] = work[row, i]
    else:
        h = time - t
        turns = NO_SOLUTION
        if count[SOLVER] != NEWTON:
            turns = solve(address, params, work, n, lanes, SUB, h)
        if turns == NO_SOLUTION and count[SOLVER] != FIXED_POINT and count[TANGENT] != 0:
            start_evenly(address, params, work, n, lanes, SUB, h)
            turns = solve_by_newton(address, params, real, count, work, SUB, OTHER, True, h)
        if turns == NO_SOLUTION:
            turns = _in_pieces(address, params, count, work, h, out)
        else:
            for i in range(n):
                out[i] = work[Y, i] + _sum(work, SUB, i, lanes)
        count[EVALUATIONS] += max(turns, 1) * count[STAGES]
    unit_alone(out, count[QUATERNION])
    return bool(turns != NO_SOLUTION)


@compiled
def _in_pieces(
    address: int, params: Array, count: Counts, work: Array, h: float, out: Array
) -> int:
    """Write the state after h from row Y, by as few shorter steps as have solutions.

    A long step whose first guess was good can be beyond one that begins without. Return the
    turns, or NO_SOLUTION with NaN in out.
    """
    n, lanes, pieces = count[N], count[LANES], 2
    for i in range(n):
        out[i] = work[Y, i]
    turns, total = NO_SOLUTION, 0
    while turns == NO_SOLUTION and pieces <= _PIECES:
        for _ in range(pieces):
            start_evenly(address, params, work, n, lanes, SUB, h / pieces)
            turns = solve(address, params, work, n, lanes, SUB, h / pieces)
            if turns == NO_SOLUTION:
                break
            total += turns + 1
            for i in range(n):
                work[Y, i] += _sum(work, SUB, i, lanes)
        for i in range(n):
            end = work[Y, i] if turns != NO_SOLUTION else np.nan
            work[Y, i] = out[i]
            if turns != NO_SOLUTION or pieces == _PIECES:
                out[i] = end
        pieces *= 2
    return total if turns != NO_SOLUTION else NO_SOLUTION


@compiled
def _sum(work: Array, row: int, i: int, lanes: int) -> float:
    """Return what a step adds to entry i."""
    total = 0.0
    for j in range(lanes):
        total += work[row, i * lanes + j]
    return total


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
    n, real = count[N], np.zeros(REALS)
    k, begun = 0, -1
    for j in range(times.shape[0]):
        k = step_at(times[j], k, knots_t)
        if begun != k:
            begun = k
            for i in range(n):
                work[Y, i] = knots_y[k, i]
                work[NEW, i] = knots_y[k + 1, i]
        time, t = times[j], knots_t[k]
        if t < time < knots_t[k + 1]:
            start_evenly(address, params, work, n, count[LANES], SUB, time - t)
        state(address, params, real, count, work, time, t, knots_t[k + 1], out[j])
