"""Stored steps and dense output of Radau IIA.

A step end is stored as the state before its quaternions are normalised, followed by the stages of
the step. Dense output from stored steps thus equals the dense output during the run bit for bit.

The polynomial through the stages has order 3 only. Corrections from ẏ and ÿ at the ends, computed
with the exact Jacobian, raise it to order 5. In stiff directions ẏ and ÿ amplify errors by hλ and
(hλ)². Filters remove these directions and are 1 − O(h³) in others: 1 − (1 − F)³ with
F = (1 − hJ/γ)⁻¹, which decreases as 1/(hλ), for ẏ, and its square for ÿ.
"""

from __future__ import annotations

import numpy as np

from ...common.arrays import Array
from ..stepping.codes import DENSE, DONE
from ..stepping.compiling import compiled, inlined
from ..stepping.kernel_call import SEEDS, call, call_tangent
from ..stepping.linear_systems import factor, finite_jacobian, solve
from ..stepping.run_state import Run, copy_an_end, quaternions_of
from ..stepping.state_rows import NEW, Y, unit, unit_alone
from . import radau_coefficients as tableau
from .radau_rows import ALONG, CORRECTION, END_RATE, FREE, MATRIX, PIVOTS, RATE, SLOPES, Z

GAMMA = tableau.GAMMA
_C1, _C2 = tableau.C1, tableau.C2


def _polynomial(c: float, a: float, b: float) -> tuple[float, float, float]:
    """Return the coefficients of u, u² and u³ of the polynomial that is 1 at c, and 0 at 0, a, b.

    NumPy's inverse of a Vandermonde matrix would depend on the processor in the last digit, and
    with it the key of the shipped bitcode.
    """
    scale = c * (c - a) * (c - b)
    return a * b / scale, -(a + b) / scale, 1.0 / scale


# End derivatives of the Lagrange polynomials of the stages, which vanish at 0.  The rows are
# contiguous, because numba compiles the addresses of other arrays instead of their values.
_POWERS = np.ascontiguousarray(
    np.transpose(
        [_polynomial(_C1, _C2, 1.0), _polynomial(_C2, _C1, 1.0), _polynomial(1.0, _C1, _C2)]
    )
)
_SLOPE, _BEND, _LAST_BEND = _POWERS[0], 2.0 * _POWERS[1], 2.0 * _POWERS[1] + 6.0 * _POWERS[2]


@inlined
def store_end(run: Run, work: Array, t: float, end_times: Array, end_states: Array) -> None:
    """Store time, state and stages of a step (hook of the step loop)."""
    if run.keep:
        n, k = run.n, run.steps
        row = NEW if run.begun else Y
        end_times[k] = t
        for i in range(n):
            end_states[k, i] = work[row, i]
            for j in range(3):
                end_states[k, (j + 1) * n + i] = work[Z + j, i]


@inlined
def load_step(run: Run, params: Array, work: Array, t_new: float, stored: Array) -> None:  # noqa: ARG001
    """Restore the stages of a stored step, and evaluate the rates at its ends (hook)."""
    for i in range(run.n):
        for row in range(3):
            work[Z + row, i] = stored[(row + 1) * run.n + i]
    call(run.address, work[Y], params, work[RATE])
    call(run.address, work[NEW], params, work[END_RATE])
    unit(work[Y], work[RATE], quaternions_of(run))


@inlined
def write_state(run: Run, params: Array, work: Array, time: float, t_new: float, out: Array) -> int:
    """Write a state inside the step, computed with the corrected stage polynomial (hook)."""
    if not copy_an_end(run, work, time, t_new, out):
        if run.known < DENSE:
            run.known = DENSE
            _fill_corrections(run, params, work, t_new - run.t)
        x = (time - run.t) / (t_new - run.t)
        y = 1.0 - x
        by_slope, by_bend, by_last = (
            x * y**3 * (1.0 + 3.0 * x),
            0.5 * x * x * y**3,
            0.5 * x**3 * y * y,
        )
        for i in range(run.n):
            correction = (
                by_slope * work[CORRECTION, i]
                + by_bend * work[CORRECTION + 1, i]
                + by_last * work[CORRECTION + 2, i]
            )
            polynomial = stage_polynomial(work[Z, i], work[Z + 1, i], work[Z + 2, i], x)
            out[i] = work[Y, i] + (polynomial + correction)
    unit_alone(out, quaternions_of(run))
    return DONE


@compiled
def _fill_corrections(run: Run, params: Array, work: Array, h: float) -> None:
    """Compute the corrections of the stage polynomial: hẏ at the start, h²ÿ at both ends."""
    n, system, pivots = run.n, MATRIX + 4 * run.n, work[PIVOTS + 2]
    seeds, slopes = work[ALONG:SLOPES], work[SLOPES:MATRIX]
    directions, second_derivatives = seeds.reshape(-1), slopes.reshape(-1)
    directions[: n * SEEDS] = 0.0
    for i in range(n):
        directions[i * SEEDS] = work[END_RATE, i]
    call_tangent(run.tangent, work[NEW], params, directions, second_derivatives)
    is_finite = True
    for i in range(n):
        work[CORRECTION + 2, i] = h * h * second_derivatives[i * SEEDS]
        is_finite = is_finite and abs(work[CORRECTION + 2, i]) < np.inf
    if not is_finite:
        finite_jacobian(run, work[NEW], params, seeds, slopes, work, MATRIX, n)
        for i in range(n):
            second_derivative = 0.0
            for j in range(n):
                second_derivative += work[MATRIX + i, j] * work[END_RATE, j]
            work[CORRECTION + 2, i] = h * h * second_derivative
    finite_jacobian(run, work[Y], params, seeds, slopes, work, MATRIX, n)
    run.evaluations += 1 + (n + SEEDS - 1) // SEEDS
    for i in range(n):
        second_derivative = 0.0
        for j in range(n):
            second_derivative += work[MATRIX + i, j] * work[RATE, j]
            work[system + i, j] = -h / GAMMA * work[MATRIX + i, j]
        work[system + i, i] += 1.0
        a, b, c = work[Z, i], work[Z + 1, i], work[Z + 2, i]
        work[CORRECTION, i] = h * work[RATE, i] - (_SLOPE[0] * a + _SLOPE[1] * b + _SLOPE[2] * c)
        work[CORRECTION + 1, i] = h * h * second_derivative - (
            _BEND[0] * a + _BEND[1] * b + _BEND[2] * c
        )
        work[CORRECTION + 2, i] -= _LAST_BEND[0] * a + _LAST_BEND[1] * b + _LAST_BEND[2] * c
    if factor(work, system, n, pivots):
        for row in range(3):
            _filter(work, system, n, pivots, work[CORRECTION + row])
            if row > 0:
                _filter(work, system, n, pivots, work[CORRECTION + row])
    else:
        work[CORRECTION : CORRECTION + 3, :n] = 0.0


@compiled
def _filter(work: Array, system: int, n: int, pivots: Array, v: Array) -> None:
    """Replace v by (1 − (1 − F)³) v = 3 F v − 3 F² v + F³ v.

    Args:
        work: Work rows.
        system: First row of the factorised matrix F⁻¹ = 1 − hJ/γ.
        n: Number of entries of the state.
        pivots: Pivots of this factorisation.
        v: Vector, (n,), changed in place.
    """
    power, total = work[FREE], work[FREE + 1]
    for i in range(n):
        power[i], total[i] = v[i], 0.0
    for weight in (3.0, -3.0, 1.0):
        solve(work, system, n, pivots, power)
        for i in range(n):
            total[i] += weight * power[i]
    for i in range(n):
        v[i] = total[i]


@compiled
def stage_polynomial(a: float, b: float, c: float, x: float) -> float:
    """Return the stage polynomial, which is 0 at the start, at fraction x of a step.

    a, b and c are its values at the three stages.
    """
    first = a * (x - _C2) * (x - 1.0) / (_C1 * (_C1 - _C2) * (_C1 - 1.0))
    second = b * (x - _C1) * (x - 1.0) / (_C2 * (_C2 - _C1) * (_C2 - 1.0))
    return x * (first + second + c * (x - _C1) * (x - _C2) / ((1.0 - _C1) * (1.0 - _C2)))
