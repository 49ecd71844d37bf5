"""Gauss–Legendre collocation of order 16 with step control, for tight tolerances.

Eight stages are evaluated at once, so that a turn of the iteration costs a few evaluations,
not eight (M. Antoñana, J. Makazaga, A. Murua, SIMD-vectorized implicit symplectic integrators
can outperform explicit ones, 2022, arXiv:2204.01603).

The error of a step is read off the highest Legendre coefficient of the rates: that is the
error of order 8 that a quadrature would make, and those of order 16 fall as its square does.
"""

from __future__ import annotations

from math import exp, log, sqrt

import numpy as np

from ...common.arrays import Array
from ..dop853 import TURN
from ..machine.kernel_call import compiled
from ..machine.registers import (
    AGAIN,
    ATOL,
    BEFORE,
    BEGUN,
    BUDGET,
    DONE,
    ENTRY,
    EVALUATIONS,
    FULL,
    KEEP,
    LANES,
    MAX_STEP,
    MAX_STEPS,
    NOT_FINITE,
    PAUSED,
    QUATERNION,
    REJECTED,
    RTOL,
    STAGES,
    STEPS,
    T_END,
    TOO_MANY,
    UNDERFLOW,
    Counts,
    H,
    N,
    T,
    first_not_finite,
    keep,
    unit_alone,
)
from .fixed_step import recall, report
from .stages import (
    CARRY,
    GUESS,
    INFO,
    LAST,
    NEW,
    NEXT_CARRY,
    OLD,
    RATE,
    SCALE,
    L,
    Y,
    finish,
    guess,
    iterate,
    prepare_guess,
    start_evenly,
)
from .stages import DIVERGED as NO_SOLUTION

__all__ = ["advance", "recall"]

_SAFETY, _SHRINK, _GROW, _HALF = 0.9, 0.25, 4.0, 0.5
_EPS = float(np.finfo(float).eps)
_ORDER = 17.0  # of the error of a step
_CALIBRATION = 1.0  # error over the square of the estimate, on the bundled robots
_LEFT = 0.01  # of the tolerance: what the iteration may leave
_FASTEST = 0.15  # quotient of changes at which a longer step takes as many more turns


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
        start_evenly(address, params, work, n, lanes, L, 1.0)
        count[EVALUATIONS] += stages
        count[ENTRY] = first_not_finite(work[RATE], n * lanes)
        if count[ENTRY] >= 0:
            count[ENTRY] //= lanes
            return NOT_FINITE
        real[H] = _first_step(real, count, work)
        count[BEGUN] = 1
    pause = count[EVALUATIONS] + count[BUDGET]
    while real[T] < real[T_END]:
        if count[EVALUATIONS] >= pause:
            return PAUSED
        if count[KEEP] and count[STEPS] + 1 >= knots_t.shape[0]:
            return FULL
        if count[STEPS] + count[REJECTED] >= count[MAX_STEPS]:
            return TOO_MANY
        t, h = real[T], real[H]
        if 0.1 * h <= _EPS * t:
            return NOT_FINITE if count[ENTRY] >= 0 else UNDERFLOW
        left = real[T_END] - t
        if h >= left:
            h = left
        elif 2.0 * h > left:
            h = 0.5 * left  # two steps of one length, not a long one and a rest
        t_new = real[T_END] if h == left else t + h
        h = t_new - t
        if real[BEFORE] > 0.0:
            prepare_guess(work, lanes, stages, GUESS, 1.0, h / real[BEFORE])
            guess(work, n, lanes, GUESS, OLD, L)
        else:
            start_evenly(address, params, work, n, lanes, L, h)
            count[EVALUATIONS] += stages
        _measure_by_tolerance(real, work, n, count[QUATERNION], stages)
        turns = iterate(address, params, work, n, lanes, L, h, _LEFT)
        count[EVALUATIONS] += (turns if turns > 0 else 1) * stages
        error = np.inf
        if turns != NO_SOLUTION:
            finish(work, n, lanes, L)
            error = _error(real, work, n, lanes)
        quotient = work[INFO, 1]  # reports write theirs there
        if error <= 1.0 and report(address, params, real, count, work, times, out, t_new) != DONE:
            error = np.inf
        if error <= 1.0:
            count[STEPS] += 1
            keep(count, work[NEW], t_new, knots_t, knots_y)
            for i in range(n):
                work[Y, i] = work[NEW, i]
                work[CARRY, i] = work[NEXT_CARRY, i]
            for i in range(n * lanes):
                work[OLD, i] = work[L, i]
            real[BEFORE] = h
            growth = _growth(error)
            if count[AGAIN]:
                growth = min(growth, 1.0)
            if turns > 2 and quotient > 0.0:
                growth = min(growth, max(_SHRINK, _FASTEST / quotient))
            count[AGAIN], count[ENTRY] = 0, -1
            real[T] = t_new
            real[H] = min(max(real[H], h) * growth, real[MAX_STEP])
        else:
            count[REJECTED] += 1
            count[AGAIN] = 1
            shrink = _HALF
            if turns == NO_SOLUTION:
                count[ENTRY] = first_not_finite(work[L], n * lanes)
                if count[ENTRY] >= 0:
                    count[ENTRY] //= lanes
                real[BEFORE] = 0.0 if count[ENTRY] >= 0 else real[BEFORE]
            elif error < np.inf:
                shrink = min(_growth(error), _SAFETY)
            real[H] = h * shrink
    return DONE


@compiled
def _growth(error: float) -> float:
    """Return by what the next step may be longer."""
    if error < 1e-300:
        return _GROW
    return min(_GROW, max(_SHRINK, _SAFETY * exp(-log(error) / _ORDER)))


@compiled
def _measure_by_tolerance(real: Array, work: Array, n: int, quaternion: int, stages: int) -> None:
    """Fill SCALE, so that a change is measured in tolerances, in the mean."""
    rtol, atol, mean = real[RTOL], real[ATOL], 1.0 / sqrt(n * stages)
    for i in range(n):
        size = abs(work[Y, i])
        if 0 <= i - quaternion < 4 and quaternion >= 0:
            size = TURN
        work[SCALE, i] = mean / (atol + rtol * size)
    work[INFO, 0] = max(1.0, 1e-9 / rtol)
    work[INFO, 1] = 0.0


@compiled
def _error(real: Array, work: Array, n: int, lanes: int) -> float:
    """Return the estimated error of a step in units of the tolerance."""
    stages, total = 8.0, 0.0
    for i in range(n):
        part = 0.0
        for j in range(lanes):
            part += work[LAST, j] * work[L, i * lanes + j]
        part *= work[SCALE, i]
        total += part * part
    # In the state's own size, of which the tolerance is a part.
    relative = sqrt(total * stages) * real[RTOL]
    if relative == 0.0:
        return 0.0
    if not relative < np.inf:
        return np.inf
    error: float = _CALIBRATION * exp(log(relative) * (_ORDER / 8.0)) / real[RTOL]
    return error


@compiled
def _first_step(real: Array, count: Counts, work: Array) -> float:
    """Return the first step: a part of the time in which the state changes by its size."""
    n, lanes, quaternion = count[N], count[LANES], count[QUATERNION]
    rtol, atol = real[RTOL], real[ATOL]
    rate = 0.0
    for i in range(n):
        scale = atol / rtol + (TURN if 0 <= i - quaternion < 4 else abs(work[Y, i]))
        rate += (work[RATE, i * lanes] / scale) ** 2
    longest: float = min(real[T_END], real[MAX_STEP])
    return min(longest, 0.1 * sqrt(n / rate)) if rate > 0.0 else longest
