"""The one loop of all methods, and what a method has to give to it.

A method is a set of `Hooks`, functions written out inside the loop; nothing is called through a
pointer.  The loop is bound to them under a name of its own: see `compiling.bound`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array
from .compiling import bind_globals, compiled, inlined
from .run_record import (
    AGAIN,
    DONE,
    ENDS,
    FULL,
    NOT_FINITE,
    PAUSED,
    STEP,
    TOO_MANY,
    UNDERFLOW,
    WANTED,
    Run,
    Runs,
)
from .state_rows import NEW, Y, keep_state

_EPS = float(np.finfo(float).eps)


# --- what a method gives -------------------------------------------------------------------


def begin_run(run: Run, params: Array, work: Array, end_times: Array, end_states: Array) -> int:
    """Keep the first knot, evaluate what the first step takes; return DONE, or why not."""
    raise NotImplementedError


def next_end_time(run: Run) -> float:
    """Return the time at which the next step is to end."""
    raise NotImplementedError


def attempt_step(run: Run, params: Array, work: Array, t_new: float) -> int:
    """Make a step to t_new from row Y to row NEW.

    Return DONE, AGAIN with the next step in run.h, WANTED, or why it cannot be made.
    """
    raise NotImplementedError


def accept_step(run: Run, work: Array, t_new: float) -> None:
    """Take the end of a step for the begin of the next, and choose its length."""
    raise NotImplementedError


def load_step(
    run: Run, params: Array, work: Array, t_new: float, end_states: Array, k: int
) -> None:
    """Fill the rows of the k-th step, whose ends are in Y and NEW, as it was made."""
    raise NotImplementedError


def write_state(run: Run, params: Array, work: Array, time: float, t_new: float, out: Array) -> int:
    """Write the state (n,) at a time in the step from run.t to t_new, its quaternion of length 1.

    run.known says what of the step is in the rows.  Return DONE; or AGAIN, WANTED, or why there
    is none, and NaN.
    """
    raise NotImplementedError


store_end = keep_state


@inlined
def equal_steps(run: Run) -> float:
    """Return the end of the next of run.total steps of one length, as `until` does."""
    k = run.steps + 1
    return run.t_end if k == run.total else k * run.h


@dataclass(frozen=True)
class Hooks:
    """The part of a method in the loop: compiled functions that do as those above."""

    begin_run: Callable[..., int]
    next_end_time: Callable[..., float]
    attempt_step: Callable[..., int]
    accept_step: Callable[..., None]
    load_step: Callable[..., None]
    write_state: Callable[..., int]
    store_end: Callable[..., None] = keep_state


# --- the loops -----------------------------------------------------------------------------


def advance(
    runs: Runs,
    params: Array,
    work: Array,
    times: Array,
    out: Array,
    end_times: Array,
    end_states: Array,
) -> int:
    """Integrate until the end, a pause, a full store of knots or a failure; return which.

    params: (p,).  work: rows, with the state in row Y.  times: (T,) sorted; out: (T, n) their
    states.  end_times: (K,), end_states: (K, n), or what `keep` writes for a knot.
    """
    run: Run = runs[0]
    if not run.begun:
        status = begin_run(run, params, work, end_times, end_states)
        if status != DONE:
            return status
        run.begun = 1
        report(run, params, work, times, out, 0.0)
    run.pause = run.evaluations + run.budget
    while run.t < run.t_end:
        if run.evaluations >= run.pause:
            return PAUSED
        if run.keep and run.steps + 1 >= end_times.shape[0]:
            return FULL
        if run.steps + run.rejected >= run.max_steps:
            return TOO_MANY
        if 0.1 * run.h <= _EPS * run.t:
            return NOT_FINITE if run.entry >= 0 else UNDERFLOW
        t_new = next_end_time(run)
        status = attempt_step(run, params, work, t_new)
        if status == DONE:
            status = report(run, params, work, times, out, t_new)
        if status == AGAIN:
            continue
        if status != DONE:
            return status
        run.steps += 1
        store_end(run, work, t_new, end_times, end_states)
        accept_step(run, work, t_new)
        run.t = t_new
    return DONE


def report(run: Run, params: Array, work: Array, times: Array, out: Array, t_new: float) -> int:
    """Write the states at the times up to t_new; return DONE, or what stopped it."""
    run.known = STEP
    while run.next < times.shape[0] and times[run.next] <= t_new:
        j = run.next
        status = write_state(run, params, work, times[j], t_new, out[j])
        if status != DONE:
            return status
        run.next += 1
    return DONE


def recall(
    runs: Runs,
    params: Array,
    work: Array,
    times: Array,
    out: Array,
    end_times: Array,
    end_states: Array,
) -> None:
    """Fill out (T, n) with the states at sorted times (T,), by the steps around them.

    NaN for those that cannot be found.
    """
    run: Run = runs[0]
    k, loaded = 0, -1
    for j in range(times.shape[0]):
        k = step_at(times[j], k, end_times)
        if loaded != k:
            loaded = k
            run.t, run.known = end_times[k], ENDS
            for i in range(run.n):
                work[Y, i] = end_states[k, i]
                work[NEW, i] = end_states[k + 1, i]
            load_step(run, params, work, end_times[k + 1], end_states, k)
        write_state(run, params, work, times[j], end_times[k + 1], out[j])


@compiled
def step_at(time: float, k: int, end_times: Array) -> int:
    """Return the step within which a time lies, from the k-th on; its end belongs to it."""
    while k + 1 < end_times.shape[0] - 1 and time > end_times[k + 1]:
        k += 1
    return k


class Batch(NamedTuple):
    """Runs of one kernel, member first.

    params: (N, p).  y0: (N, n).  times: (T,), y: (N, T, n) the states there.  outcomes: (N,) of
    OUTCOME, what became of each.  stop: (1,), not 0 to give up.  no_times, no_knots: (0,) and
    (0, n), as nothing is kept.
    """

    params: Array
    y0: Array
    times: Array
    y: Array
    outcomes: NDArray[np.void]
    stop: NDArray[np.int64]
    no_times: Array
    no_knots: Array


OUTCOME = np.dtype(
    [
        ("t", np.float64),
        *((name, np.int64) for name in ("status", "entry", "steps", "rejected", "evaluations")),
    ],
    align=True,
)


def members(batch: Batch, first_run: Runs, runs: Runs, work: Array, first: int, last: int) -> int:
    """Run members first to last − 1; return the one that wants a derivative to go on, or last.

    first_run: registers of a run that has not begun.  runs: those of the one that goes on.
    """
    run: Run = runs[0]
    for member in range(first, last):
        if run.member != member:
            runs[0] = first_run[0]
            run.member = member
            for i in range(run.n):
                work[Y, i] = batch.y0[member, i]
        status = PAUSED
        while status == PAUSED:
            if batch.stop[0] != 0:
                return last
            status = advance(
                runs, batch.params[member], work, batch.times, batch.y[member],
                batch.no_times, batch.no_knots,
            )  # fmt: skip
        if status == WANTED:
            return member
        end = batch.outcomes[member]
        end.t, end.status, end.entry = run.t, status, run.entry
        end.steps, end.rejected, end.evaluations = run.steps, run.rejected, run.evaluations
    return last


@dataclass(frozen=True)
class Loops:
    """The loops above, bound to a method and compiled."""

    advance: Callable[..., int]
    recall: Callable[..., None]
    members: Callable[..., int]


def loops(name: str, hooks: Hooks) -> Loops:
    """Return the loops of a method.  name: of this method alone, and the same in every process."""
    parts = vars(hooks)
    told = inlined(bind_globals(report, f"{name}_report", **parts))
    run = compiled(bind_globals(advance, f"{name}_advance", **parts, report=told))
    return Loops(
        run,
        compiled(bind_globals(recall, f"{name}_recall", **parts)),
        compiled(bind_globals(members, f"{name}_members", advance=run)),
    )
