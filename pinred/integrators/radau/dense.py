"""The record of a step of Radau IIA: its knots, and the states between its ends.

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
from ..stepping.compiling import compiled, inlined
from ..stepping.kernel_call import SEEDS, call, call_tangent
from ..stepping.linear_systems import factor, jacobian, solve
from ..stepping.run_record import DENSE, DONE, Run
from ..stepping.state_rows import NEW, Y, copy_an_end, unit, unit_alone

# Rows of `work`: the rates at both ends of a step, the stages less the state, what is lacking at
# the ends, rows to work on, for Newton's method and for the Jacobian.
RATE, END_RATE, Z, LACK, FREE, PIVOTS, ALONG = 2, 4, 5, 8, 11, 18, 21
SLOPES = ALONG + SEEDS
MATRIX = SLOPES + SEEDS  # the Jacobian, three systems of a step, and one for what is lacking
KEPT = 4  # numbers at a knot for an entry of the state

GAMMA = float(tableau.MU_REAL)
_C1, _C2 = float(tableau.C[0]), float(tableau.C[1])
# Derivatives at the ends of the polynomials that are 1 at one stage and 0 at the others and at 0.
_POWERS = np.linalg.inv(np.vander([_C1, _C2, 1.0], 4, increasing=True)[:, 1:])
_SLOPE, _BEND, _LAST_BEND = _POWERS[0], 2.0 * _POWERS[1], 2.0 * _POWERS[1] + 6.0 * _POWERS[2]


@inlined
def store_end(run: Run, work: Array, t: float, end_times: Array, end_states: Array) -> None:
    """Implement the hook `store_end`: store time, state and stages."""
    if run.keep:
        n, k = run.n, run.steps
        row = NEW if run.begun else Y
        end_times[k] = t
        for i in range(n):
            end_states[k, i] = work[row, i]
            for j in range(3):
                end_states[k, (j + 1) * n + i] = work[Z + j, i]


@inlined
def load_step(
    run: Run,
    params: Array,
    work: Array,
    t_new: float,  # noqa: ARG001
    end_states: Array,
    k: int,
) -> None:
    """Implement the hook `load_step`: with the stages, which the knot at the end has."""
    for i in range(run.n):
        for row in range(3):
            work[Z + row, i] = end_states[k + 1, (row + 1) * run.n + i]
    call(run.address, work[Y], params, work[RATE])
    call(run.address, work[NEW], params, work[END_RATE])
    unit(work[Y], work[RATE], run.quaternion)


@inlined
def write_state(run: Run, params: Array, work: Array, time: float, t_new: float, out: Array) -> int:
    """Implement the hook `write_state`."""
    if not copy_an_end(run, work, time, t_new, out):
        if run.known < DENSE:
            run.known = DENSE
            _complete(run, params, work, t_new - run.t)
        x = (time - run.t) / (t_new - run.t)
        y = 1.0 - x
        slope, bend, last = x * y**3 * (1.0 + 3.0 * x), 0.5 * x * x * y**3, 0.5 * x**3 * y * y
        for i in range(run.n):
            lack = slope * work[LACK, i] + bend * work[LACK + 1, i] + last * work[LACK + 2, i]
            through = between(work[Z, i], work[Z + 1, i], work[Z + 2, i], x)
            out[i] = work[Y, i] + (through + lack)
    unit_alone(out, run.quaternion)
    return DONE


@compiled
def _complete(run: Run, params: Array, work: Array, h: float) -> None:
    """Fill the rows of what the stages' polynomial lacks: hẏ at the begin, h²ÿ at both ends."""
    n, system, pivots = run.n, MATRIX + 4 * run.n, work[PIVOTS + 2]
    seeds, slopes = work[ALONG:SLOPES], work[SLOPES:MATRIX]
    along, bent = seeds.reshape(-1), slopes.reshape(-1)
    along[: n * SEEDS] = 0.0
    for i in range(n):
        along[i * SEEDS] = work[END_RATE, i]
    call_tangent(run.tangent, work[NEW], params, along, bent)
    for i in range(n):
        work[LACK + 2, i] = h * h * bent[i * SEEDS]
    jacobian(run.tangent, work[Y], params, seeds, slopes, work, MATRIX, n)
    run.evaluations += 1 + (n + SEEDS - 1) // SEEDS
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
def between(a: float, b: float, c: float, x: float) -> float:
    """Return the polynomial through 0 at 0 and the stages a, b, c of a step, at its part x."""
    first = a * (x - _C2) * (x - 1.0) / (_C1 * (_C1 - _C2) * (_C1 - 1.0))
    second = b * (x - _C1) * (x - 1.0) / (_C2 * (_C2 - _C1) * (_C2 - 1.0))
    return x * (first + second + c * (x - _C1) * (x - _C2) / ((1.0 - _C1) * (1.0 - _C2)))
