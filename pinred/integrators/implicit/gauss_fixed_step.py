"""Gauss–Legendre collocation with steps of equal length: symplectic, of any even order to 16.

On the canonical form, with the quaternion as Cayley–Klein lift of the momentum, the map preserves
the Poisson structure and the Casimirs: see docs/integrators.md. A state inside a step is the end
of a shorter step of the same order.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from ...common.arrays import Array
from ...common.memo import once_for_all
from ..stepping.compiling import compiled, inlined
from ..stepping.run_state import (
    AGAIN,
    AUTO,
    DIVERGED,
    DONE,
    FIXED_POINT,
    NEW,
    NEWTON,
    NOT_FINITE,
    STEP,
    WANTED,
    Run,
    Y,
    copy_an_end,
    copy_row,
    first_not_finite,
    keep_state,
    quaternions_of,
    unit_alone,
)
from ..stepping.step_loop import Hooks, Stepper, equal_steps, loops
from .gauss_newton import MAIN, newton_rows, prepare, refine
from .gauss_newton import SUB as REPORT
from .gauss_stages import (
    CARRY,
    GUESS,
    INFO,
    NEXT_CARRY,
    NO_SOLUTION,
    OLD,
    RATE,
    ROUND_OFF,
    SUB,
    WITHIN,
    L,
    add_increments,
    finish,
    guess,
    guess_evenly,
    iterate,
    prepare_guess,
    scale_by_largest,
    work_rows,
)

_STAY = 64  # number of steps with Newton's method before fixed-point iteration is tried again
_SEGMENTS = 64  # largest number of substeps into which a step to a report time is split
# Change, relative to the largest absolute value of the state, above which an iteration that has
# stopped improving counts as not converged.
_SLACK = 1e-6


@inlined
def begin_run(run: Run, params: Array, work: Array, end_times: Array, end_states: Array) -> int:  # noqa: ARG001
    """Store the initial state and normalise its quaternions (hook of the step loop)."""
    keep_state(run, work, 0.0, end_times, end_states)
    unit_alone(work[Y], quaternions_of(run))
    for i in range(run.n):
        work[CARRY, i] = 0.0
    return DONE


@inlined
def load_step(run: Run, params: Array, work: Array, t_new: float, stored: Array) -> None:  # noqa: ARG001
    """Normalise the quaternions of the initial state, which is stored as given (hook)."""
    if run.t == 0.0:
        unit_alone(work[Y], quaternions_of(run))


@inlined
def attempt_step(run: Run, params: Array, work: Array, t_new: float) -> int:  # noqa: ARG001
    """Solve the stages by fixed-point iteration or Newton's method (hook)."""
    n, lanes, stages = run.n, run.lanes, run.stages
    auto = run.solver == AUTO
    newton = run.solver == NEWTON or (auto and run.remaining > 0)
    if newton and run.tangent == 0:
        return WANTED
    # All steps have exactly the same length; round-off of the time is ignored.
    h = run.h
    if run.steps == 0:
        guess_evenly(run, params, work, L, h)
        if not_finite_in(run, work, L):
            return NOT_FINITE
        prepare_guess(work, lanes, stages, GUESS, 1.0, 1.0)
    else:
        guess(work, n, lanes, GUESS, OLD, L)
    if newton:
        iterations = find_stages_by_newton(
            run, params, work, L, MAIN, abs(h - run.factored) > 0.0, h
        )
    else:
        iterations = find_stages(run, params, work, L, h)
    if iterations == NO_SOLUTION and auto and not newton:
        run.remaining = _STAY
        return AGAIN
    if iterations == NO_SOLUTION:
        return NOT_FINITE if not_finite_in(run, work, RATE if newton else L) else DIVERGED
    if auto and not newton and iterations > _iterations_worth_newton(n, stages):
        run.remaining = _STAY
    elif run.remaining > 0:
        run.remaining -= 1
    finish(work, n, lanes, L)
    return DONE


@inlined
def accept_step(run: Run, work: Array, t_new: float) -> None:  # noqa: ARG001
    """Start the next step at the end of this step (hook)."""
    continue_from_end(run, work)
    run.before = run.h


@inlined
def write_state(run: Run, params: Array, work: Array, time: float, t_new: float, out: Array) -> int:
    """Write a state inside the step, computed as the end of a shorter step (hook)."""
    if write_inside_state(run, params, work, time, t_new, out):
        return DONE
    return WANTED if run.solver == AUTO and run.tangent == 0 else DIVERGED


@compiled
def continue_from_end(run: Run, work: Array) -> None:
    """Start the next step at the end of this step, and keep this step's stage increments."""
    for i in range(run.n):
        work[Y, i] = work[NEW, i]
        work[CARRY, i] = work[NEXT_CARRY, i]
    for i in range(run.n * run.lanes):
        work[OLD, i] = work[L, i]


@compiled
def not_finite_in(run: Run, work: Array, row: int) -> bool:
    """Set run.entry to the first non-finite entry of a stage row; return whether there is one."""
    run.entry = first_not_finite(work[row], run.n * run.lanes)
    if run.entry >= 0:
        run.entry //= run.lanes
    return run.entry >= 0


@compiled
def find_stages(run: Run, params: Array, work: Array, row: int, h: float) -> int:
    """Solve the stages of a step to round-off by fixed-point iteration.

    Args:
        run: Registers of the run.
        params: Parameters, (p,).
        work: Work rows.
        row: Row of the stage increments L, which contains a first guess.
        h: Length of the step [s].
    Returns:
        The number of iterations, or NO_SOLUTION.
    """
    scale_by_largest(work, run.n, run.lanes, Y, row)
    work[INFO, 0] = _SLACK
    return iterate(run, params, work, row, h, ROUND_OFF)


@compiled
def find_stages_by_newton(
    run: Run, params: Array, work: Array, row: int, which: int, fresh: bool, h: float
) -> int:
    """Solve the stages of a step to round-off by Newton's method.

    Args:
        run: Registers of the run.
        params: Parameters, (p,).
        work: Work rows.
        row: Row of the stage increments L, which contains a first guess.
        which: Factorisation to use, MAIN or REPORT.
        fresh: Whether to compute this factorisation first.
        h: Length of the step [s].
    Returns:
        The number of iterations, or NO_SOLUTION.
    """
    scale_by_largest(work, run.n, run.lanes, Y, row)
    if fresh and not prepare(run, params, work, which, h):
        return NO_SOLUTION
    iterations = refine(run, params, work, row, which, fresh, h)
    if which == MAIN:
        run.factored = 0.0 if iterations == NO_SOLUTION else h
    return iterations


@compiled
def _iterations_worth_newton(n: int, stages: int) -> int:
    """Return the number of fixed-point iterations that take as long as one Newton solve.

    The number was measured on the bundled robots. A step rarely needs as many iterations, so
    Newton's method is used only where fixed-point iteration converges slowly or not at all.
    """
    return 40 + n * ((stages + 1) // 2)


@compiled
def write_inside_state(
    run: Run, params: Array, work: Array, time: float, t_new: float, out: Array
) -> bool:
    """Write the state at a time in the step from run.t to t_new.

    A state inside the step is the end of a shorter step from the same start.

    Args:
        run: Registers of the run.
        params: Parameters, (p,).
        work: Work rows.
        time: Time of the state [s].
        t_new: End of the step [s].
        out: State, (n,), output.
    Returns:
        Whether the stages of the shorter step were solved.
    """
    n, lanes, solved = run.n, run.lanes, True
    if not copy_an_end(run, work, time, t_new, out):
        h = time - run.t
        if run.known == STEP:
            prepare_guess(work, lanes, run.stages, WITHIN, 0.0, h / (t_new - run.t))
            guess(work, n, lanes, WITHIN, L, SUB)
        else:
            guess_evenly(run, params, work, SUB, h)
        solved = run.solver != NEWTON and find_stages(run, params, work, SUB, h) != NO_SOLUTION
        if not solved and run.solver != FIXED_POINT and run.tangent != 0:
            guess_evenly(run, params, work, SUB, h)
            iterations = find_stages_by_newton(run, params, work, SUB, REPORT, True, h)
            solved = iterations != NO_SOLUTION
        if solved:
            copy_row(work[Y], out)
            add_increments(work, SUB, lanes, out)
        else:
            solved = _write_by_segments(run, params, work, h, out)
    unit_alone(out, quaternions_of(run))
    return solved


@compiled
def _write_by_segments(run: Run, params: Array, work: Array, h: float, out: Array) -> bool:
    """Write the state at time h, computed with 2, 4, … substeps; return whether they converged."""
    n, lanes, segments = run.n, run.lanes, 2
    for i in range(n):
        out[i] = work[Y, i]
    iterations = NO_SOLUTION
    while iterations == NO_SOLUTION and segments <= _SEGMENTS:
        for _ in range(segments):
            guess_evenly(run, params, work, SUB, h / segments)
            iterations = find_stages(run, params, work, SUB, h / segments)
            if iterations == NO_SOLUTION:
                break
            add_increments(work, SUB, lanes, work[Y, :n])
        for i in range(n):
            end = work[Y, i] if iterations != NO_SOLUTION else np.nan
            work[Y, i] = out[i]
            if iterations != NO_SOLUTION or segments == _SEGMENTS:
                out[i] = end
        segments *= 2
    return bool(iterations != NO_SOLUTION)


LOOPS = loops(
    "Gauss", Hooks(begin_run, equal_steps, attempt_step, accept_step, write_state, load_step)
)


@once_for_all
def fixed_stepper(stages: int, *, needs_tangent: bool) -> Stepper:
    """Return the stepper with steps of equal length, for a number of stages."""
    rows, wide_rows = partial(work_rows, stages), partial(newton_rows, stages)
    return Stepper(LOOPS, rows, needs_tangent=needs_tangent, newton_rows=wide_rows)
