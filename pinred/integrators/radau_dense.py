"""What a step of Radau IIA leaves: its knots, and the states between its ends.

A knot holds the state that a step has left, its quaternion not yet back at length one, and
after it the stages of the step, from which the states in it follow to the last bit.
"""

from __future__ import annotations

from scipy.integrate._ivp import radau as tableau

from ..arrays import Array
from .kernel import compiled
from .run import BEGUN, KEEP, NEXT, QUATERNION, STEPS, Counts, N, T, unit_alone

# Rows of `work`: the state, the end of the step, the stages less the state.
Y, NEW, Z = 0, 1, 5
KEPT = 4  # numbers at a knot for an entry of the state

_C1, _C2 = float(tableau.C[0]), float(tableau.C[1])


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
def report(real: Array, count: Counts, work: Array, times: Array, out: Array, t_new: float) -> None:
    """Write the states at the times that lie in a step from real[T] to t_new."""
    while count[NEXT] < times.shape[0] and times[count[NEXT]] <= t_new:
        j = count[NEXT]
        _state(work, count[N], count[QUATERNION], times[j], real[T], t_new, out[j])
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
    else:
        x = (time - t) / (t_new - t)
        for i in range(n):
            out[i] = work[Y, i] + between(work[Z, i], work[Z + 1, i], work[Z + 2, i], x)
    unit_alone(out, quaternion)


@compiled
def recall(
    address: int,  # noqa: ARG001
    params: Array,  # noqa: ARG001
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
        while k + 1 < knots_t.shape[0] - 1 and times[j] > knots_t[k + 1]:
            k += 1
        if begun != k:
            begun = k
            for i in range(n):
                work[Y, i] = knots_y[k, i]
                work[NEW, i] = knots_y[k + 1, i]
                for row in range(3):
                    work[Z + row, i] = knots_y[k + 1, (row + 1) * n + i]
            unit_alone(work[Y], quaternion)
        _state(work, n, quaternion, times[j], knots_t[k], knots_t[k + 1], out[j])


@compiled
def between(a: float, b: float, c: float, x: float) -> float:
    """Return the polynomial through 0 at 0 and the stages a, b, c of a step, at its part x."""
    first = a * (x - _C2) * (x - 1.0) / (_C1 * (_C1 - _C2) * (_C1 - 1.0))
    second = b * (x - _C1) * (x - 1.0) / (_C2 * (_C2 - _C1) * (_C2 - 1.0))
    return x * (first + second + c * (x - _C1) * (x - _C2) / ((1.0 - _C1) * (1.0 - _C2)))
