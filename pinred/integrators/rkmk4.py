"""RKMK4 over a kernel: the classical Runge–Kutta method on ℝᵏ times the unit quaternions.

H. Munthe-Kaas, Runge–Kutta methods on Lie groups, BIT 38 (1998) 92–111; High order
Runge–Kutta methods on manifolds, Appl. Numer. Math. 29 (1999) 115–127; E. Hairer,
C. Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed., section IV.8.

In a step q = q₀ exp(u) with u in ℝ³, and body rate ω gives u̇ = dexp⁻¹₋ᵤ ω.  The rows of
rates hold u̇ in the first three of the quaternion's entries and zero in the fourth.
Between the ends of a step, y and u are cubic Hermite polynomials.
"""

from __future__ import annotations

from math import cos, sin, sqrt, tan

from ..common.arrays import Array
from .machine.kernel_call import call, combination, compiled
from .machine.registers import (
    BEGUN,
    BUDGET,
    DONE,
    ENTRY,
    EVALUATIONS,
    FULL,
    KEEP,
    NEXT,
    NOT_FINITE,
    PAUSED,
    QUATERNION,
    STEPS,
    T_END,
    TOTAL,
    Counts,
    H,
    N,
    T,
    first_not_finite,
    keep,
    step_at,
    unit_alone,
)

# Rows of `work`: 0 to 3 are the stages' rates; MEAN is the weighted mean of them.
LAST, Y, NEW, STAGE, MEAN = 4, 5, 6, 7, 8
ROWS = 9

_to_1 = combination(STAGE, Y, [0.5])
_to_2 = combination(STAGE, Y, [0.0, 0.5])
_to_3 = combination(STAGE, Y, [0.0, 0.0, 1.0])
_to_end = combination(NEW, Y, [1 / 6, 1 / 3, 1 / 3, 1 / 6])
_mean = combination(MEAN, None, [1 / 6, 1 / 3, 1 / 3, 1 / 6])


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

    Arguments as in dop853.advance.
    """
    n, quaternion = count[N], count[QUATERNION]
    if not count[BEGUN]:
        unit_alone(work[Y], quaternion)
        keep(count, work[Y], 0.0, knots_t, knots_y)
        _rate(address, params, work, work[Y], 0, quaternion)
        count[EVALUATIONS] += 1
        count[ENTRY] = first_not_finite(work[0], n)
        if count[ENTRY] >= 0:
            return NOT_FINITE
        count[BEGUN] = 1
        _report(count, work, times, out, 0.0, 0.0)
    pause = count[EVALUATIONS] + count[BUDGET]
    while count[STEPS] < count[TOTAL]:
        if count[EVALUATIONS] >= pause:
            return PAUSED
        if count[KEEP] and count[STEPS] + 1 >= knots_t.shape[0]:
            return FULL
        k = count[STEPS] + 1
        t_new = real[T_END] if k == count[TOTAL] else k * real[H]
        _step(address, params, work, quaternion, t_new - real[T])
        count[EVALUATIONS] += 4
        count[ENTRY] = first_not_finite(work[NEW], n)
        if count[ENTRY] < 0:
            count[ENTRY] = first_not_finite(work[LAST], n)
        if count[ENTRY] >= 0:
            return NOT_FINITE
        _report(count, work, times, out, real[T], t_new)
        count[STEPS] += 1
        keep(count, work[NEW], t_new, knots_t, knots_y)
        for i in range(n):
            work[Y, i] = work[NEW, i]
            work[0, i] = work[LAST, i]
        real[T] = t_new
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
            for i in range(n):
                work[Y, i] = knots_y[k, i]
            _rate(address, params, work, work[Y], 0, quaternion)
            _step(address, params, work, quaternion, knots_t[k + 1] - knots_t[k])
        _state(work, n, quaternion, times[j], knots_t[k], knots_t[k + 1], out[j])


@compiled
def _step(address: int, params: Array, work: Array, quaternion: int, h: float) -> None:
    """Fill NEW, LAST and MEAN by one step h from row Y with rate row 0."""
    stage = work[STAGE]
    _to_1(work, h)
    _turn(work[Y], work[0], 0.5 * h, stage, quaternion)
    _rate(address, params, work, stage, 1, quaternion)
    _straighten(work[0], 0.5 * h, work[1], quaternion)
    _to_2(work, h)
    _turn(work[Y], work[1], 0.5 * h, stage, quaternion)
    _rate(address, params, work, stage, 2, quaternion)
    _straighten(work[1], 0.5 * h, work[2], quaternion)
    _to_3(work, h)
    _turn(work[Y], work[2], h, stage, quaternion)
    _rate(address, params, work, stage, 3, quaternion)
    _straighten(work[2], h, work[3], quaternion)
    _to_end(work, h)
    _mean(work, 1.0)
    _turn(work[Y], work[MEAN], h, work[NEW], quaternion)
    unit_alone(work[NEW], quaternion)
    _rate(address, params, work, work[NEW], LAST, quaternion)


@compiled
def _rate(address: int, params: Array, work: Array, y: Array, row: int, quaternion: int) -> None:
    """Fill a row with the rates at y, and the quaternion's part with the body rate ω = 2 q⁻¹ q̇."""
    call(address, y, params, work[row])
    if quaternion >= 0:
        q, d = y[quaternion : quaternion + 4], work[row, quaternion : quaternion + 4]
        a = q[3] * d[0] - q[0] * d[3] - (q[1] * d[2] - q[2] * d[1])
        b = q[3] * d[1] - q[1] * d[3] - (q[2] * d[0] - q[0] * d[2])
        c = q[3] * d[2] - q[2] * d[3] - (q[0] * d[1] - q[1] * d[0])
        d[0], d[1], d[2] = 2.0 * a, 2.0 * b, 2.0 * c
        d[3] *= 0.0  # keeps what is not finite


@compiled
def _turn(start: Array, rate: Array, h: float, end: Array, quaternion: int) -> None:
    """Put start exp(h rate) into end: the quaternions of three rows (n,)."""
    if quaternion >= 0:
        q, u = start[quaternion : quaternion + 4], rate[quaternion : quaternion + 3]
        a, b, c = h * u[0], h * u[1], h * u[2]
        half = 0.5 * sqrt(a * a + b * b + c * c)
        # Below 1e-4 the second term of sin(half)/half is its last that counts.
        factor = 0.5 * (sin(half) / half if half > 1e-4 else 1.0 - half * half / 6.0)
        w = cos(half)
        a, b, c = factor * a, factor * b, factor * c
        p = end[quaternion : quaternion + 4]
        p[0] = q[3] * a + w * q[0] + (q[1] * c - q[2] * b)
        p[1] = q[3] * b + w * q[1] + (q[2] * a - q[0] * c)
        p[2] = q[3] * c + w * q[2] + (q[0] * b - q[1] * a)
        p[3] = q[3] * w - (q[0] * a + q[1] * b + q[2] * c)


@compiled
def _straighten(rate: Array, h: float, row: Array, quaternion: int) -> None:
    """Replace the body rate ω in a row by u̇ = dexp⁻¹₋ᵤ ω with u = h rate.

    dexp⁻¹₋ᵤ ω = ω + ½ u × ω + c u × (u × ω),  c = (1 − (θ/2) cot(θ/2)) / θ²,  θ = |u|.
    """
    if quaternion >= 0:
        k, w = rate[quaternion : quaternion + 3], row[quaternion : quaternion + 3]
        a, b, c = h * k[0], h * k[1], h * k[2]
        x, y, z = b * w[2] - c * w[1], c * w[0] - a * w[2], a * w[1] - b * w[0]
        square = a * a + b * b + c * c
        factor = 1 / 12 + square / 720 * (1.0 + square / 42.0 * (1.0 + square / 40.0))
        if square > 0.01:
            half = 0.5 * sqrt(square)
            factor = (1.0 - half / tan(half)) / square
        w[0] += 0.5 * x + factor * (b * z - c * y)
        w[1] += 0.5 * y + factor * (c * x - a * z)
        w[2] += 0.5 * z + factor * (a * y - b * x)


@compiled
def _report(count: Counts, work: Array, times: Array, out: Array, t: float, t_new: float) -> None:
    """Write the states at the times that lie in the step from t to t_new."""
    while count[NEXT] < times.shape[0] and times[count[NEXT]] <= t_new:
        j = count[NEXT]
        _state(work, count[N], count[QUATERNION], times[j], t, t_new, out[j])
        count[NEXT] += 1


@compiled
def _state(
    work: Array, n: int, quaternion: int, time: float, t: float, t_new: float, out: Array
) -> None:
    """Write the state at a time in the step from t to t_new, (n,), its quaternion of length 1."""
    if time <= t or time >= t_new:
        row = Y if time <= t else NEW
        for i in range(n):
            out[i] = work[row, i]
        return
    h = t_new - t
    x = (time - t) / h
    y = 1.0 - x
    from_move, from_start, from_end = x * x * (3.0 - 2.0 * x), h * x * y * y, -h * x * x * y
    for i in range(n):
        move = work[NEW, i] - work[Y, i]
        out[i] = work[Y, i] + (
            from_move * move + from_start * work[0, i] + from_end * work[LAST, i]
        )
    if quaternion >= 0:
        u = work[STAGE]  # free now
        for i in range(quaternion, quaternion + 4):
            u[i] = work[LAST, i]
        _straighten(work[MEAN], h, u, quaternion)
        for i in range(quaternion, quaternion + 3):
            u[i] = from_move * h * work[MEAN, i] + from_start * work[0, i] + from_end * u[i]
        _turn(work[Y], u, 1.0, out, quaternion)
        unit_alone(out, quaternion)
