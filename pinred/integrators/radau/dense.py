"""What a step of Radau IIA leaves: its knots, and the states between its ends.

A knot holds the state that a step has left, its quaternion not yet back at length one, and
after it the stages of the step, so that the states in it follow to the last bit.

The polynomial through the stages is of order 3 only.  What it lacks of ẏ and ÿ at the ends,
which the exact Jacobian gives, makes it one of order 5.  In stiff directions these say little,
ẏ magnifies errors by hλ and ÿ by its square, so they go through filters that are 1 − O(h³) in
others: 1 − (1 − F)³ with F = (1 − hJ/γ)⁻¹, which falls as 1/(hλ), and its square.
"""

from __future__ import annotations

import numpy as np
from scipy.integrate._ivp import radau as tableau

from ...common.arrays import Array
from ..machine.kernel_call import SEEDS, call, call_tangent, compiled
from ..machine.newton import factor, jacobian, solve
from ..machine.registers import (
    BEGUN,
    EVALUATIONS,
    KEEP,
    NEXT,
    QUATERNION,
    STEPS,
    TANGENT,
    Counts,
    N,
    T,
    step_at,
    unit,
    unit_alone,
)

# Rows of `work`: state and end of a step with their rates, the stages less the state, what is
# lacking at the ends, rows to work on, for Newton's method and for the Jacobian.
Y, NEW, RATE, END_RATE, Z, LACK, FREE, PIVOTS, ALONG = 0, 1, 2, 4, 5, 8, 11, 18, 21
SLOPES = ALONG + SEEDS
MATRIX = SLOPES + SEEDS  # the Jacobian, three systems of a step, and one for what is lacking
KEPT = 4  # numbers at a knot for an entry of the state

GAMMA = float(tableau.MU_REAL)
_C1, _C2 = float(tableau.C[0]), float(tableau.C[1])
# Derivatives at the ends of the polynomials that are 1 at one stage and 0 at the others and at 0.
_POWERS = np.linalg.inv(np.vander([_C1, _C2, 1.0], 4, increasing=True)[:, 1:])
_SLOPE, _BEND, _LAST_BEND = _POWERS[0], 2.0 * _POWERS[1], 2.0 * _POWERS[1] + 6.0 * _POWERS[2]


@compiled
def keep(count: Counts, work: Array, t: float, knots_t: Array, knots_y: Array) -> None:
    """Write down a knot: time t, the state that a step has left, and its stages."""
    if count[KEEP]:
        n, k = count[N], count[STEPS]
        row = NEW if count[BEGUN] else Y
        knots_t[k] = t
        for i in range(n):
            knots_y[k, i] = work[row, i]
            for j in range(3):
                knots_y[k, (j + 1) * n + i] = work[Z + j, i]


@compiled
def report(
    params: Array,
    real: Array,
    count: Counts,
    work: Array,
    times: Array,
    out: Array,
    t_new: float,
) -> None:
    """Write the states at the times that lie in a step from real[T] to t_new."""
    ready = False
    while count[NEXT] < times.shape[0] and times[count[NEXT]] <= t_new:
        j = count[NEXT]
        if real[T] < times[j] < t_new and not ready:
            ready = True
            _complete(params, count, work, t_new - real[T])
        _state(work, count[N], count[QUATERNION], times[j], real[T], t_new, out[j])
        count[NEXT] += 1


@compiled
def _complete(params: Array, count: Counts, work: Array, h: float) -> None:
    """Fill the rows of what the stages' polynomial lacks: hẏ at the begin, h²ÿ at both ends."""
    n, system, pivots = count[N], MATRIX + 4 * count[N], work[PIVOTS + 2]
    seeds, slopes = work[ALONG:SLOPES], work[SLOPES:MATRIX]
    along, bent = seeds.reshape(-1), slopes.reshape(-1)
    along[: n * SEEDS] = 0.0
    for i in range(n):
        along[i * SEEDS] = work[END_RATE, i]
    call_tangent(count[TANGENT], work[NEW], params, along, bent)
    for i in range(n):
        work[LACK + 2, i] = h * h * bent[i * SEEDS]
    jacobian(count[TANGENT], work[Y], params, seeds, slopes, work, MATRIX, n)
    count[EVALUATIONS] += 1 + (n + SEEDS - 1) // SEEDS
    for i in range(n):
        bend = 0.0
        for j in range(n):
            bend += work[MATRIX + i, j] * work[RATE, j]
            work[system + i, j] = -h / GAMMA * work[MATRIX + i, j]
        work[system + i, i] += 1.0
        a, b, c = work[Z, i], work[Z + 1, i], work[Z + 2, i]
        work[LACK, i] = h * work[RATE, i] - (_SLOPE[0] * a + _SLOPE[1] * b + _SLOPE[2] * c)
        work[LACK + 1, i] = h * h * bend - (_BEND[0] * a + _BEND[1] * b + _BEND[2] * c)
        work[LACK + 2, i] -= _LAST_BEND[0] * a + _LAST_BEND[1] * b + _LAST_BEND[2] * c
    if factor(work, system, n, pivots):
        for row in range(3):
            _filter(work, system, n, pivots, work[LACK + row])
            if row > 0:
                _filter(work, system, n, pivots, work[LACK + row])
    else:
        work[LACK : LACK + 3, :n] = 0.0


@compiled
def _filter(work: Array, system: int, n: int, pivots: Array, v: Array) -> None:
    """Replace v by (1 − (1 − F)³) v = 3 F v − 3 F² v + F³ v."""
    once, total = work[FREE], work[FREE + 1]
    for i in range(n):
        once[i], total[i] = v[i], 0.0
    for weight in (3.0, -3.0, 1.0):
        solve(work, system, n, pivots, once)
        for i in range(n):
            total[i] += weight * once[i]
    for i in range(n):
        v[i] = total[i]


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
        slope, bend, last = x * y**3 * (1.0 + 3.0 * x), 0.5 * x * x * y**3, 0.5 * x**3 * y * y
        for i in range(n):
            lack = slope * work[LACK, i] + bend * work[LACK + 1, i] + last * work[LACK + 2, i]
            through = between(work[Z, i], work[Z + 1, i], work[Z + 2, i], x)
            out[i] = work[Y, i] + (through + lack)
    unit_alone(out, quaternion)


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
    """Fill out (T, n) with the states at sorted times (T,) by the stages at the knots."""
    n, quaternion = count[N], count[QUATERNION]
    k, begun = 0, -1
    for j in range(times.shape[0]):
        k = step_at(times[j], k, knots_t)
        if begun != k:
            begun, ready = k, False
            for i in range(n):
                work[Y, i] = knots_y[k, i]
                work[NEW, i] = knots_y[k + 1, i]
                for row in range(3):
                    work[Z + row, i] = knots_y[k + 1, (row + 1) * n + i]
            call(address, work[Y], params, work[RATE])
            call(address, work[NEW], params, work[END_RATE])
            unit(work[Y], work[RATE], quaternion)
        if knots_t[k] < times[j] < knots_t[k + 1] and not ready:
            ready = True
            _complete(params, count, work, knots_t[k + 1] - knots_t[k])
        _state(work, n, quaternion, times[j], knots_t[k], knots_t[k + 1], out[j])


@compiled
def between(a: float, b: float, c: float, x: float) -> float:
    """Return the polynomial through 0 at 0 and the stages a, b, c of a step, at its part x."""
    first = a * (x - _C2) * (x - 1.0) / (_C1 * (_C1 - _C2) * (_C1 - 1.0))
    second = b * (x - _C1) * (x - 1.0) / (_C2 * (_C2 - _C1) * (_C2 - 1.0))
    return x * (first + second + c * (x - _C1) * (x - _C2) / ((1.0 - _C1) * (1.0 - _C2)))
