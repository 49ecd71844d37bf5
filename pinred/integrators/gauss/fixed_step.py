"""Gauss–Legendre collocation with steps of one length: symplectic, of any even order to 16.

On the canonical form, with the quaternion as Cayley–Klein lift of the momentum, the map keeps
the Poisson structure and the Casimirs: see docs/integrators.md.  Reports between the ends of
steps are steps of their own, of the same order.
"""

from __future__ import annotations

import numpy as np

from ...common.arrays import Array
from ...common.memo import once_for_all
from ..stepping.compiling import compiled, inlined
from ..stepping.run_record import (
    AGAIN,
    AUTO,
    DIVERGED,
    DONE,
    FIXED_POINT,
    NEWTON,
    NOT_FINITE,
    STEP,
    WANTED,
    Run,
)
from ..stepping.state_rows import (
    NEW,
    Y,
    copy_an_end,
    first_not_finite,
    keep_state,
    unit_alone,
)
from ..stepping.step_loop import Hooks, equal_steps, loops
from ..stepping.stepper import Stepper
from .newton import MAIN, prepare, refine, rows_of_stages
from .newton import SUB as OTHER
from .stages import (
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
    finish,
    guess,
    guess_evenly,
    iterate,
    prepare_guess,
    scale_by_largest,
)

_STAY = 64  # steps by Newton's method before fixed-point iteration is tried again
_PIECES = 64  # at most, of a step up to a report
_SLACK = 1e-6  # of the largest number: an iteration that stops further off has not converged


@inlined
def begin_run(run: Run, params: Array, work: Array, end_times: Array, end_states: Array) -> int:  # noqa: ARG001
    """Implement the hook `begin_run`."""
    unit_alone(work[Y], run.quaternion)
    keep_state(run, work, 0.0, end_times, end_states)
    for i in range(run.n):
        work[CARRY, i] = 0.0
    return DONE


@inlined
def attempt_step(run: Run, params: Array, work: Array, t_new: float) -> int:  # noqa: ARG001
    """Implement the hook `attempt_step`."""
    n, lanes, stages = run.n, run.lanes, run.stages
    auto = run.solver == AUTO
    newton = run.solver == NEWTON or (auto and run.remaining > 0)
    if newton and run.tangent == 0:
        return WANTED
    # The steps are of one length to the last bit: round-off in the clock does not count.
    h = run.h
    if run.steps == 0:
        guess_evenly(run, params, work, L, h)
        if not_finite_in(run, work, L):
            return NOT_FINITE
        prepare_guess(work, lanes, stages, GUESS, 1.0, 1.0)
    else:
        guess(work, n, lanes, GUESS, OLD, L)
    if newton:
        turns = find_stages_by_newton(run, params, work, L, MAIN, abs(h - run.factored) > 0.0, h)
    else:
        turns = find_stages(run, params, work, L, h)
    if turns == NO_SOLUTION and auto and not newton:
        run.remaining = _STAY
        return AGAIN
    if turns == NO_SOLUTION:
        return NOT_FINITE if not_finite_in(run, work, RATE if newton else L) else DIVERGED
    if auto and not newton and turns > _turns_worth_newton(n, stages):
        run.remaining = _STAY
    elif run.remaining > 0:
        run.remaining -= 1
    finish(work, n, lanes, L)
    return DONE


@inlined
def accept_step(run: Run, work: Array, t_new: float) -> None:  # noqa: ARG001
    """Implement the hook `accept_step`."""
    take_the_end(run, work)
    run.before = run.h


@inlined
def load_step(
    run: Run, params: Array, work: Array, t_new: float, end_states: Array, k: int
) -> None:
    """Implement the hook `load_step`: the ends are all it takes."""


@inlined
def write_state(run: Run, params: Array, work: Array, time: float, t_new: float, out: Array) -> int:
    """Implement the hook `write_state`."""
    if between(run, params, work, time, t_new, out):
        return DONE
    return WANTED if run.solver == AUTO and run.tangent == 0 else DIVERGED


@compiled
def take_the_end(run: Run, work: Array) -> None:
    """Let the next step begin where this one ends, and remember this one."""
    for i in range(run.n):
        work[Y, i] = work[NEW, i]
        work[CARRY, i] = work[NEXT_CARRY, i]
    for i in range(run.n * run.lanes):
        work[OLD, i] = work[L, i]


@compiled
def not_finite_in(run: Run, work: Array, row: int) -> bool:
    """Note which number is not finite in a row over stages, if any; return whether one is."""
    run.entry = first_not_finite(work[row], run.n * run.lanes)
    if run.entry >= 0:
        run.entry //= run.lanes
    return run.entry >= 0


@compiled
def find_stages(run: Run, params: Array, work: Array, row: int, h: float) -> int:
    """Find a step's stages to round-off by fixed points; return the turns, or NO_SOLUTION."""
    scale_by_largest(work, run.n, run.lanes, Y, row)
    work[INFO, 0] = _SLACK
    return iterate(run, params, work, row, h, ROUND_OFF)


@compiled
def find_stages_by_newton(
    run: Run, params: Array, work: Array, row: int, which: int, fresh: bool, h: float
) -> int:
    """Solve a step to round-off by Newton's method; return the turns, or NO_SOLUTION.

    which, fresh: whose factors, and whether they have to be made.
    """
    scale_by_largest(work, run.n, run.lanes, Y, row)
    if fresh and not prepare(run, params, work, which, h):
        return NO_SOLUTION
    turns = refine(run, params, work, row, which, fresh, h)
    if which == MAIN:
        run.factored = 0.0 if turns == NO_SOLUTION else h
    return turns


@compiled
def _turns_worth_newton(n: int, stages: int) -> int:
    """Return about how many turns of the fixed point take as long as Newton's method.

    Measured on the bundled robots.  So many are rare: Newton's method is for steps at which
    fixed-point iteration hardly converges, or does not.
    """
    return 40 + n * ((stages + 1) // 2)


@compiled
def between(run: Run, params: Array, work: Array, time: float, t_new: float, out: Array) -> bool:
    """Write the state at a time in the step from run.t to t_new, (n,); return whether it is one.

    Between the ends it is that of a shorter step from the begin.
    """
    n, lanes, found = run.n, run.lanes, True
    if not copy_an_end(run, work, time, t_new, out):
        h = time - run.t
        if run.known == STEP:
            prepare_guess(work, lanes, run.stages, WITHIN, 0.0, h / (t_new - run.t))
            guess(work, n, lanes, WITHIN, L, SUB)
        else:
            guess_evenly(run, params, work, SUB, h)
        found = run.solver != NEWTON and find_stages(run, params, work, SUB, h) != NO_SOLUTION
        if not found and run.solver != FIXED_POINT and run.tangent != 0:
            guess_evenly(run, params, work, SUB, h)
            turns = find_stages_by_newton(run, params, work, SUB, OTHER, True, h)
            found = turns != NO_SOLUTION
        if found:
            for i in range(n):
                out[i] = work[Y, i] + _sum(work, SUB, i, lanes)
        else:
            found = _in_pieces(run, params, work, h, out)
    unit_alone(out, run.quaternion)
    return found


@compiled
def _in_pieces(run: Run, params: Array, work: Array, h: float, out: Array) -> bool:
    """Write the state after h from row Y, by as few shorter steps as have solutions.

    A long step whose first guess was good can be beyond one that begins without.  Return whether
    there is one, with NaN in out if not.
    """
    n, lanes, pieces = run.n, run.lanes, 2
    for i in range(n):
        out[i] = work[Y, i]
    turns = NO_SOLUTION
    while turns == NO_SOLUTION and pieces <= _PIECES:
        for _ in range(pieces):
            guess_evenly(run, params, work, SUB, h / pieces)
            turns = find_stages(run, params, work, SUB, h / pieces)
            if turns == NO_SOLUTION:
                break
            for i in range(n):
                work[Y, i] += _sum(work, SUB, i, lanes)
        for i in range(n):
            end = work[Y, i] if turns != NO_SOLUTION else np.nan
            work[Y, i] = out[i]
            if turns != NO_SOLUTION or pieces == _PIECES:
                out[i] = end
        pieces *= 2
    return bool(turns != NO_SOLUTION)


@compiled
def _sum(work: Array, row: int, i: int, lanes: int) -> float:
    """Return what a step adds to entry i."""
    total = 0.0
    for j in range(lanes):
        total += work[row, i * lanes + j]
    return total


LOOPS = loops(
    "Gauss", Hooks(begin_run, equal_steps, attempt_step, accept_step, load_step, write_state)
)


@once_for_all
def fixed_stepper(stages: int, *, needs_tangent: bool) -> Stepper:
    """Return the stepper with steps of equal length, for a number of stages."""
    return Stepper(LOOPS, rows_of_stages(stages), needs_tangent=needs_tangent)
