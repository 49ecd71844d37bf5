"""Gauss–Legendre collocation of order 16 with step control, for tight tolerances.

The kernel evaluates all eight stages at once, so an iteration costs a few evaluations instead of
eight (M. Antoñana, J. Makazaga, A. Murua, SIMD-vectorized implicit symplectic integrators can
outperform explicit ones, 2022, arXiv:2204.01603).

The highest Legendre coefficient of the rates estimates the error of a quadrature of order 8. The
error of the method, of order 16, is proportional to its square.
"""

from __future__ import annotations

from functools import partial
from math import exp, log, sqrt

import numpy as np

from ...common.arrays import Array
from ...common.memo import once_for_all
from ..stepping.compiling import compiled, inlined
from ..stepping.run_state import (
    DONE,
    NOT_FINITE,
    STAGES_KEPT,
    Run,
    Y,
    entry_size,
    first_step_by_rate,
    keep_state,
    lanes_of,
    quaternions_of,
    reject_step,
    unit_alone,
)
from ..stepping.step_loop import Hooks, Stepper, loops
from .gauss_fixed_step import continue_from_end, load_step, not_finite_in, write_inside_state
from .gauss_stages import (
    CARRY,
    GUESS,
    INFO,
    LAST,
    NO_SOLUTION,
    OLD,
    RATE,
    SCALE,
    L,
    finish,
    guess,
    guess_evenly,
    iterate,
    prepare_guess,
    work_rows,
)

_SAFETY, _SHRINK, _GROW, _HALF = 0.9, 0.25, 4.0, 0.5
_ORDER = 17.0  # exponent p of the error of one step, which is proportional to h^p
# Ratio of the true error to the square of the quadrature's error estimate, measured on the bundled
# robots.
_CALIBRATION = 1.0
_LEFT = 0.01  # limit on the iteration error, as a fraction of the tolerance
# Contraction of the fixed-point iteration to which the step length is limited, because longer steps
# would cost more iterations than they save.
_FASTEST = 0.15


@inlined
def begin_run(run: Run, params: Array, work: Array, end_times: Array, end_states: Array) -> int:
    """Evaluate the initial rates and choose the first step (hook of the step loop)."""
    keep_state(run, work, 0.0, end_times, end_states)
    unit_alone(work[Y], quaternions_of(run))
    for i in range(run.n):
        work[CARRY, i] = 0.0
    guess_evenly(run, params, work, L, 1.0)
    if not_finite_in(run, work, RATE):
        return NOT_FINITE
    run.h = first_step_by_rate(run, work[Y], work[RATE], run.lanes, 0.1)
    return DONE


@inlined
def next_end_time(run: Run) -> float:
    """Return t + h, or split the remaining time into equal steps (hook)."""
    h, remaining = run.h, run.t_end - run.t
    if h >= remaining:
        h = remaining
    elif 2.0 * h > remaining:
        h = 0.5 * remaining  # two equal steps instead of a long and a very short one
    return run.t_end if h == remaining else run.t + h


@inlined
def attempt_step(run: Run, params: Array, work: Array, t_new: float) -> int:
    """Solve the stages and estimate the error; return DONE, or AGAIN with a shorter step (hook)."""
    n, lanes, h = run.n, run.lanes, t_new - run.t
    if run.before > 0.0:
        prepare_guess(work, lanes, run.stages, GUESS, 1.0, h / run.before)
        guess(work, n, lanes, GUESS, OLD, L)
    else:
        guess_evenly(run, params, work, L, h)
    _measure_by_tolerance(run, work)
    iterations = iterate(run, params, work, L, h, _LEFT)
    if iterations == NO_SOLUTION:
        run.before = 0.0 if not_finite_in(run, work, L) else run.before
        return reject_step(run, h * _HALF)
    finish(work, n, lanes, L)
    error = _error(run, work)
    if not error <= 1.0:
        return reject_step(run, h * (min(_growth(error), _SAFETY) if error < np.inf else _HALF))
    run.growth = _growth(error)
    if run.again:
        run.growth = min(run.growth, 1.0)
    quotient = work[INFO, 1]
    if iterations > 2 and quotient > 0.0:
        run.growth = min(run.growth, max(_SHRINK, _FASTEST / quotient))
    return DONE


@inlined
def accept_step(run: Run, work: Array, t_new: float) -> None:
    """Continue from the end of the step, and choose the next length (hook)."""
    continue_from_end(run, work)
    run.before = t_new - run.t
    run.again, run.entry = 0, -1
    run.h = min(max(run.h, run.before) * run.growth, run.max_step)


@inlined
def store_end(run: Run, work: Array, t: float, end_times: Array, end_states: Array) -> None:
    """Store a step end, followed by the stage increments L of the step if stages are requested."""
    keep_state(run, work, t, end_times, end_states)
    if run.keep == STAGES_KEPT:
        for i in range(run.n * run.lanes):
            end_states[run.steps, run.n + i] = work[L, i]


@inlined
def write_state(run: Run, params: Array, work: Array, time: float, t_new: float, out: Array) -> int:
    """Write a state inside the step; reject the step if that state does not converge (hook)."""
    if write_inside_state(run, params, work, time, t_new, out):
        return DONE
    return reject_step(run, (t_new - run.t) * _HALF)


@compiled
def _growth(error: float) -> float:
    """Return the factor for the next step length; error: in units of the tolerance."""
    if error < 1e-300:
        return _GROW
    return min(_GROW, max(_SHRINK, _SAFETY * exp(-log(error) / _ORDER)))


@compiled
def _measure_by_tolerance(run: Run, work: Array) -> None:
    """Fill SCALE so that the norm of a change is its root mean square in units of the tolerance."""
    rtol, atol, mean = run.rtol, run.atol, 1.0 / sqrt(run.n * run.stages)
    for i in range(run.n):
        work[SCALE, i] = mean / (atol + rtol * entry_size(work[Y], i, quaternions_of(run)))
    work[INFO, 0] = max(1.0, 1e-9 / rtol)
    work[INFO, 1] = 0.0


@compiled
def _error(run: Run, work: Array) -> float:
    """Return the estimated error of a step in units of the tolerance."""
    lanes, total = run.lanes, 0.0
    for i in range(run.n):
        coefficient = 0.0
        for j in range(lanes):
            coefficient += work[LAST, j] * work[L, i * lanes + j]
        coefficient *= work[SCALE, i]
        total += coefficient * coefficient
    # The error of the quadrature, relative to the size of the state.
    relative = sqrt(total * run.stages) * run.rtol
    if relative == 0.0:
        return 0.0
    if not relative < np.inf:
        return np.inf
    error: float = _CALIBRATION * exp(log(relative) * (_ORDER / 8.0)) / run.rtol
    return error


LOOPS = loops(
    "AdaptiveGauss",
    Hooks(begin_run, next_end_time, attempt_step, accept_step, write_state, load_step, store_end),
)


@once_for_all
def adaptive_stepper(stages: int) -> Stepper:
    """Return the stepper with step control, for a number of stages."""
    return Stepper(LOOPS, partial(work_rows, stages), stages=lanes_of(stages))
