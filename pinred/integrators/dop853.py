"""DOP853 over a kernel: steps, step control and dense output.

E. Hairer, S. P. Nørsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd ed.,
Springer 1993, sections II.4 (step control, first step), II.5 and II.6 (dense output), and
Hairer's code dop853.f, whose constants are used here.  The coefficients are SciPy's copy.

The state that a knot holds is the one that the step before has left, its quaternion not
yet back at length one: from it the step can be repeated to the last bit.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from scipy.integrate._ivp import dop853_coefficients as tableau

from ..common.arrays import Array
from .machine.kernel_call import call, combination, compiled
from .machine.registers import (
    AGAIN,
    ATOL,
    BEGUN,
    BUDGET,
    DONE,
    ENTRY,
    EVALUATIONS,
    FULL,
    KEEP,
    MAX_STEP,
    MAX_STEPS,
    NEXT,
    NOT_FINITE,
    PAUSED,
    QUATERNION,
    REJECTED,
    RTOL,
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
    step_at,
    unit,
    unit_alone,
)

# Rows of `work`: 0 to 15 are the stages' rates, 12 the rate at the end of the step.
LAST, Y, NEW, STAGE, ERROR5, ERROR3, DENSE = 12, 16, 17, 18, 19, 20, 21
ROWS = 28

_SAFETY, _SHRINK, _GROW, _CRASH = 0.9, 0.333, 6.0, 0.1
_EPS = float(np.finfo(float).eps)

_A = tableau.A
_to_1 = combination(STAGE, Y, _A[1])
_to_2 = combination(STAGE, Y, _A[2])
_to_3 = combination(STAGE, Y, _A[3])
_to_4 = combination(STAGE, Y, _A[4])
_to_5 = combination(STAGE, Y, _A[5])
_to_6 = combination(STAGE, Y, _A[6])
_to_7 = combination(STAGE, Y, _A[7])
_to_8 = combination(STAGE, Y, _A[8])
_to_9 = combination(STAGE, Y, _A[9])
_to_10 = combination(STAGE, Y, _A[10])
_to_11 = combination(STAGE, Y, _A[11])
_to_end = combination(NEW, Y, tableau.B)
_error5 = combination(ERROR5, None, tableau.E5)
_error3 = combination(ERROR3, None, tableau.E3)
_to_13 = combination(STAGE, Y, _A[13])
_to_14 = combination(STAGE, Y, _A[14])
_to_15 = combination(STAGE, Y, _A[15])
_dense_3 = combination(DENSE + 3, None, tableau.D[0])
_dense_4 = combination(DENSE + 4, None, tableau.D[1])
_dense_5 = combination(DENSE + 5, None, tableau.D[2])
_dense_6 = combination(DENSE + 6, None, tableau.D[3])


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

    params: (p,).  real, count: see run.py.  work: (ROWS, stride), with the state in row Y.
    times: (T,) sorted; out: (T, n) their states.  knots_t: (K,), knots_y: (K, n).
    """
    n, quaternion = count[N], count[QUATERNION]
    if not count[BEGUN]:
        keep(count, work[Y], 0.0, knots_t, knots_y)
        call(address, work[Y], params, work[0])
        count[EVALUATIONS] += 1
        unit(work[Y], work[0], quaternion)
        count[ENTRY] = first_not_finite(work[0], n)
        if count[ENTRY] >= 0:
            return NOT_FINITE
        real[H] = _first_step(address, params, real, count, work)
        count[BEGUN] = 1
        _report(address, params, real, count, work, times, out, 0.0, 0.0)
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
        t_new = real[T_END] if t + 1.01 * h >= real[T_END] else t + h
        h = t_new - t  # what the clock shows is what the state is moved by
        _stages(address, params, work, h)
        count[EVALUATIONS] += 11
        error = _error(real, work, n, quaternion, h)
        accepted = error <= 1.0
        if accepted:
            call(address, work[NEW], params, work[LAST])
            count[EVALUATIONS] += 1
            accepted = first_not_finite(work[LAST], n) < 0
        if accepted:
            _report(address, params, real, count, work, times, out, t_new, h)
            count[STEPS] += 1
            keep(count, work[NEW], t_new, knots_t, knots_y)
            for i in range(n):
                work[Y, i] = work[NEW, i]
                work[0, i] = work[LAST, i]
            unit(work[Y], work[0], quaternion)
            growth = min(_GROW, max(_SHRINK, _SAFETY / max(_root8(error), 1e-300)))
            if count[AGAIN]:
                growth = min(growth, 1.0)
            else:
                count[ENTRY] = -1  # clear of what was not finite
            count[AGAIN] = 0
            real[T] = t_new
            real[H] = min(h * growth, real[MAX_STEP])
        else:
            count[REJECTED] += 1
            count[AGAIN] = 1
            shrink = max(_SHRINK, _SAFETY / _root8(error))
            if not 1.0 < error < np.inf:  # something is not finite
                shrink = _CRASH
                count[ENTRY] = _culprit(work, n)
            real[H] = h * shrink
    return DONE


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
    """Fill out (T, n) with the states at sorted times (T,) by repeating the steps at them."""
    n, quaternion = count[N], count[QUATERNION]
    k, begun = 0, -1
    for j in range(times.shape[0]):
        k = step_at(times[j], k, knots_t)
        if begun != k:
            begun = k
            ready = False
            for i in range(n):
                work[Y, i] = knots_y[k, i]
                work[NEW, i] = knots_y[k + 1, i]
            call(address, work[Y], params, work[0])
            unit(work[Y], work[0], quaternion)
        t, h = knots_t[k], knots_t[k + 1] - knots_t[k]
        if t < times[j] < knots_t[k + 1] and not ready:
            ready = True
            _stages(address, params, work, h)
            call(address, work[NEW], params, work[LAST])
            _prepare(address, params, work, n, h)
        _state(work, n, quaternion, times[j], t, knots_t[k + 1], out[j])


@compiled
def _stages(address: int, params: Array, work: Array, h: float) -> None:
    """Fill rates 1 to 11 and the state at the end of a step h from row Y with rate row 0."""
    stage = work[STAGE]
    _to_1(work, h)
    call(address, stage, params, work[1])
    _to_2(work, h)
    call(address, stage, params, work[2])
    _to_3(work, h)
    call(address, stage, params, work[3])
    _to_4(work, h)
    call(address, stage, params, work[4])
    _to_5(work, h)
    call(address, stage, params, work[5])
    _to_6(work, h)
    call(address, stage, params, work[6])
    _to_7(work, h)
    call(address, stage, params, work[7])
    _to_8(work, h)
    call(address, stage, params, work[8])
    _to_9(work, h)
    call(address, stage, params, work[9])
    _to_10(work, h)
    call(address, stage, params, work[10])
    _to_11(work, h)
    call(address, stage, params, work[11])
    _to_end(work, h)


# What a quaternion's entries are measured by: a turn by an angle changes it by half of that,
# and the mean over four entries halves it again, so that the tolerance is that of the angle.
TURN = 0.25


@compiled
def _error(real: Array, work: Array, n: int, quaternion: int, h: float) -> float:
    """Return the estimated error of a step in units of the tolerance (II.10.17)."""
    rtol, atol = real[RTOL], real[ATOL]
    _error5(work, 1.0)
    _error3(work, 1.0)
    sum5 = sum3 = 0.0
    for i in range(n):
        size = max(abs(work[Y, i]), abs(work[NEW, i]))
        if 0 <= i - quaternion < 4 and quaternion >= 0:
            size = TURN
        inverse = 1.0 / (atol + rtol * size)
        e5, e3 = work[ERROR5, i] * inverse, work[ERROR3, i] * inverse
        sum5 += e5 * e5
        sum3 += e3 * e3
    mixed = sum5 + 0.01 * sum3
    if mixed == 0.0:
        return 0.0
    return h * sum5 / sqrt(n * mixed)


@compiled
def _root8(value: float) -> float:
    return sqrt(sqrt(sqrt(value)))


@compiled
def _first_step(address: int, params: Array, real: Array, count: Counts, work: Array) -> float:
    """Return the first step (Hairer's hinit), with time in units of √(|y|/|ÿ|).

    Hairer measures time in seconds, and so finds other steps for the same motion in other
    units.  Where |y| or |ẏ| is nothing, a fraction of the end time stands for their ratio.
    """
    n, quaternion = count[N], count[QUATERNION]
    rtol, atol, t_end = real[RTOL], real[ATOL], real[T_END]
    size = rate = 0.0
    for i in range(n):
        scale = atol + rtol * abs(work[Y, i])
        if 0 <= i - quaternion < 4 and quaternion >= 0:
            scale = atol + rtol * TURN
        work[ERROR5, i] = scale
        size += (work[Y, i] / scale) ** 2
        rate += (work[0, i] / scale) ** 2
    unit_time: float = 1e-4 * t_end
    if size > 1e-10 and rate * t_end**2 > 1e-10:
        unit_time = sqrt(size / rate)
    h: float = min(0.01 * unit_time, t_end, real[MAX_STEP])
    for i in range(n):
        work[STAGE, i] = work[Y, i] + h * work[0, i]
    call(address, work[STAGE], params, work[1])
    count[EVALUATIONS] += 1
    bend = 0.0
    for i in range(n):
        bend += ((work[1, i] - work[0, i]) / work[ERROR5, i]) ** 2
    if size > 1e-10 and bend > 0.0:
        unit_time = sqrt(sqrt(size) * h / sqrt(bend))
    steepest = max(sqrt(bend) / h * unit_time**2, sqrt(rate) * unit_time)
    limit: float = min(100.0 * h, t_end, real[MAX_STEP])
    if not steepest < np.inf:
        return h
    if steepest <= 1e-15:
        return limit
    return min(limit, unit_time * _root8(0.01 / steepest))


@compiled
def _culprit(work: Array, n: int) -> int:
    """Return the entry that was the first not to be finite in a trial step, −1 for none."""
    for row in range(LAST):
        entry = first_not_finite(work[row], n)
        if entry >= 0:
            return entry
    entry = first_not_finite(work[NEW], n)
    if entry < 0:
        entry = first_not_finite(work[LAST], n)
    return entry


@compiled
def _report(
    address: int,
    params: Array,
    real: Array,
    count: Counts,
    work: Array,
    times: Array,
    out: Array,
    t_new: float,
    h: float,
) -> None:
    """Write the states at the times that lie in a step from real[T] to t_new."""
    ready = False
    while count[NEXT] < times.shape[0] and times[count[NEXT]] <= t_new:
        j = count[NEXT]
        if real[T] < times[j] < t_new and not ready:
            ready = True
            _prepare(address, params, work, count[N], h)
            count[EVALUATIONS] += 3
        _state(work, count[N], count[QUATERNION], times[j], real[T], t_new, out[j])
        count[NEXT] += 1


@compiled
def _prepare(address: int, params: Array, work: Array, n: int, h: float) -> None:
    """Fill the rows of the dense output (II.6), of order 7, with three more stages."""
    stage = work[STAGE]
    _to_13(work, h)
    call(address, stage, params, work[13])
    _to_14(work, h)
    call(address, stage, params, work[14])
    _to_15(work, h)
    call(address, stage, params, work[15])
    for i in range(n):
        move, start, end = work[NEW, i] - work[Y, i], h * work[0, i], h * work[LAST, i]
        work[DENSE, i] = move
        work[DENSE + 1, i] = start - move
        work[DENSE + 2, i] = 2.0 * move - (start + end)
    _dense_3(work, h)
    _dense_4(work, h)
    _dense_5(work, h)
    _dense_6(work, h)


@compiled
def _state(
    work: Array, n: int, quaternion: int, time: float, t: float, t_new: float, out: Array
) -> None:
    """Write the state at a time in the step from t to t_new, (n,), its quaternion of length 1."""
    if time <= t or time >= t_new:
        row = Y if time <= t else NEW
        for i in range(n):
            out[i] = work[row, i]
    else:
        x = (time - t) / (t_new - t)
        y = 1.0 - x
        for i in range(n):
            high = work[DENSE + 3, i] + x * (
                work[DENSE + 4, i] + y * (work[DENSE + 5, i] + x * work[DENSE + 6, i])
            )
            low = work[DENSE + 1, i] + x * (work[DENSE + 2, i] + y * high)
            out[i] = work[Y, i] + x * (work[DENSE, i] + y * low)
    unit_alone(out, quaternion)
