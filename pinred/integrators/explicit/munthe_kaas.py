"""RKMK4 over a kernel: the classical Runge–Kutta method on ℝᵏ times the unit quaternions.

H. Munthe-Kaas, Runge–Kutta methods on Lie groups, BIT 38 (1998) 92–111; High order
Runge–Kutta methods on manifolds, Appl. Numer. Math. 29 (1999) 115–127; E. Hairer,
C. Lubich, G. Wanner, Geometric Numerical Integration, 2nd ed., section IV.8.

Within a step q = q₀ exp(u) with u in ℝ³, and the body rate ω gives u̇ = dexp⁻¹₋ᵤ ω. A row of
rates contains u̇ in the first three of the quaternion's entries and zero in the fourth. Dense
output interpolates y and u by cubic Hermite polynomials.
"""

from __future__ import annotations

from functools import partial
from math import cos, sin, sqrt, tan

from ...common.arrays import Array
from ..stepping.compiling import compiled, inlined
from ..stepping.intrinsics import call
from ..stepping.run_state import (
    DONE,
    NEW,
    NOT_FINITE,
    Quaternions,
    Run,
    Y,
    copy_an_end,
    first_entries,
    first_not_finite,
    keep_state,
    padded_rows,
    quaternions_of,
    unit_alone,
)
from ..stepping.step_loop import Hooks, Stepper, equal_steps, loops
from .row_programs import row_sum

# Rows of `work` after the two state rows: the state of a stage, the weighted mean of the stage
# rates, the four stage rates, and the rate at the end of the step.
STAGE, MEAN, RATE = 2, 3, 4
LAST = RATE + 4
ROWS = LAST + 1

_WEIGHTS = [(RATE, 1 / 6), (RATE + 1, 1 / 3), (RATE + 2, 1 / 3), (RATE + 3, 1 / 6)]
_to_1 = row_sum(STAGE, Y, [(RATE, 0.5)])
_to_2 = row_sum(STAGE, Y, [(RATE + 1, 0.5)])
_to_3 = row_sum(STAGE, Y, [(RATE + 2, 1.0)])
_to_end = row_sum(NEW, Y, _WEIGHTS)
_mean = row_sum(MEAN, None, _WEIGHTS)


@inlined
def begin_run(run: Run, params: Array, work: Array, end_times: Array, end_states: Array) -> int:
    """Evaluate the initial rates (hook of the step loop)."""
    unit_alone(work[Y], quaternions_of(run))
    keep_state(run, work, 0.0, end_times, end_states)
    _rate(run.address, params, work, work[Y], RATE, quaternions_of(run))
    run.evaluations += 1
    run.entry = first_not_finite(work[RATE], run.n)
    return NOT_FINITE if run.entry >= 0 else DONE


@inlined
def attempt_step(run: Run, params: Array, work: Array, t_new: float) -> int:
    """Compute a step of fixed length (hook)."""
    _step(run.address, params, work, quaternions_of(run), t_new - run.t)
    run.evaluations += 4
    run.entry = first_not_finite(work[NEW], run.n)
    if run.entry < 0:
        run.entry = first_not_finite(work[LAST], run.n)
    return NOT_FINITE if run.entry >= 0 else DONE


@inlined
def accept_step(run: Run, work: Array, t_new: float) -> None:  # noqa: ARG001
    """Start the next step at the end of this step (hook)."""
    for i in range(run.n):
        work[Y, i] = work[NEW, i]
        work[RATE, i] = work[LAST, i]


@inlined
def load_step(run: Run, params: Array, work: Array, t_new: float, stored: Array) -> None:  # noqa: ARG001
    """Recompute a stored step, so that states inside it can be written (hook)."""
    _rate(run.address, params, work, work[Y], RATE, quaternions_of(run))
    _step(run.address, params, work, quaternions_of(run), t_new - run.t)


@inlined
def write_state(run: Run, params: Array, work: Array, time: float, t_new: float, out: Array) -> int:  # noqa: ARG001
    """Write a state inside the step, computed with cubic Hermite polynomials (hook)."""
    if not copy_an_end(run, work, time, t_new, out):
        _within(run.n, work, quaternions_of(run), time - run.t, t_new - run.t, out)
    return DONE


@compiled
def _step(address: int, params: Array, work: Array, quaternions: Quaternions, h: float) -> None:
    """Compute rows NEW, LAST and MEAN with a step of length h from row Y with rates in row RATE."""
    stage = work[STAGE]
    _to_1(work, h)
    _turn(work[Y], work[RATE], 0.5 * h, stage, quaternions)
    _rate(address, params, work, stage, RATE + 1, quaternions)
    _straighten(work[RATE], 0.5 * h, work[RATE + 1], quaternions)
    _to_2(work, h)
    _turn(work[Y], work[RATE + 1], 0.5 * h, stage, quaternions)
    _rate(address, params, work, stage, RATE + 2, quaternions)
    _straighten(work[RATE + 1], 0.5 * h, work[RATE + 2], quaternions)
    _to_3(work, h)
    _turn(work[Y], work[RATE + 2], h, stage, quaternions)
    _rate(address, params, work, stage, RATE + 3, quaternions)
    _straighten(work[RATE + 2], h, work[RATE + 3], quaternions)
    _to_end(work, h)
    _mean(work, 1.0)
    _turn(work[Y], work[MEAN], h, work[NEW], quaternions)
    unit_alone(work[NEW], quaternions)
    _rate(address, params, work, work[NEW], LAST, quaternions)


@compiled
def _rate(
    address: int, params: Array, work: Array, y: Array, row: int, quaternions: Quaternions
) -> None:
    """Compute the rates at y in a row, with the body rate ω = 2 q⁻¹ q̇ in place of q̇."""
    call(address, y, params, work[row])
    for first in first_entries(quaternions):
        q, d = y[first : first + 4], work[row, first : first + 4]
        a = q[3] * d[0] - q[0] * d[3] - (q[1] * d[2] - q[2] * d[1])
        b = q[3] * d[1] - q[1] * d[3] - (q[2] * d[0] - q[0] * d[2])
        c = q[3] * d[2] - q[2] * d[3] - (q[0] * d[1] - q[1] * d[0])
        d[0], d[1], d[2] = 2.0 * a, 2.0 * b, 2.0 * c
        d[3] *= 0.0  # sets the entry to zero, but keeps infinities and NaN non-finite


@compiled
def _turn(start: Array, rate: Array, h: float, end: Array, quaternions: Quaternions) -> None:
    """Set the quaternion of `end` to the quaternion of `start` times exp(h rate)."""
    for first in first_entries(quaternions):
        q, u = start[first : first + 4], rate[first : first + 3]
        a, b, c = h * u[0], h * u[1], h * u[2]
        half = 0.5 * sqrt(a * a + b * b + c * c)
        # Below 1e-4 the third term of the series of sin(half)/half is less than round-off.
        factor = 0.5 * (sin(half) / half if half > 1e-4 else 1.0 - half * half / 6.0)
        w = cos(half)
        a, b, c = factor * a, factor * b, factor * c
        p = end[first : first + 4]
        p[0] = q[3] * a + w * q[0] + (q[1] * c - q[2] * b)
        p[1] = q[3] * b + w * q[1] + (q[2] * a - q[0] * c)
        p[2] = q[3] * c + w * q[2] + (q[0] * b - q[1] * a)
        p[3] = q[3] * w - (q[0] * a + q[1] * b + q[2] * c)


@compiled
def _straighten(rate: Array, h: float, row: Array, quaternions: Quaternions) -> None:
    """Replace the body rate ω in a row by u̇ = dexp⁻¹₋ᵤ ω with u = h rate.

    dexp⁻¹₋ᵤ ω = ω + ½ u × ω + c u × (u × ω),  c = (1 − (θ/2) cot(θ/2)) / θ²,  θ = |u|.
    """
    for first in first_entries(quaternions):
        k, w = rate[first : first + 3], row[first : first + 3]
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
def _within(
    n: int, work: Array, quaternions: Quaternions, time: float, h: float, out: Array
) -> None:
    """Write the state (n,) at `time` within a step of length h, by cubic interpolation."""
    x = time / h
    y = 1.0 - x
    by_difference, by_start, by_end = x * x * (3.0 - 2.0 * x), h * x * y * y, -h * x * x * y
    for i in range(n):
        difference = work[NEW, i] - work[Y, i]
        out[i] = work[Y, i] + (
            by_difference * difference + by_start * work[RATE, i] + by_end * work[LAST, i]
        )
    rates = work[STAGE]  # a row that is not in use between steps
    for first in first_entries(quaternions):
        for i in range(first, first + 4):
            rates[i] = work[LAST, i]
    _straighten(work[MEAN], h, rates, quaternions)
    for first in first_entries(quaternions):
        for i in range(first, first + 3):
            u = by_difference * h * work[MEAN, i] + by_start * work[RATE, i]
            rates[i] = u + by_end * rates[i]
    _turn(work[Y], rates, 1.0, out, quaternions)
    unit_alone(out, quaternions)


STEPPER = Stepper(
    loops(
        "RKMK4", Hooks(begin_run, equal_steps, attempt_step, accept_step, write_state, load_step)
    ),
    partial(padded_rows, ROWS),
)
