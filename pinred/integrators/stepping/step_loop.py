"""The step loop of all methods, and the hooks with which a method defines its steps.

A method is a set of `Hooks`, functions inlined into the loop without calls through pointers. The
loop is bound to them under a unique name: see `compiling.bind_globals`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array
from .compiling import bind_globals, compiled, inlined, unbound
from .run_state import (
    AGAIN,
    DONE,
    ENDS,
    FULL,
    NEW,
    NOT_FINITE,
    PAUSED,
    STEP,
    TOO_MANY,
    UNDERFLOW,
    WANTED,
    Run,
    Runs,
    Y,
    keep_state,
    quaternions_of,
    unit_alone,
)

_EPS = float(np.finfo(float).eps)


# `loops` binds these names to the hooks of a method, see `Hooks`.
begin_run = next_end_time = attempt_step = accept_step = load_step = write_state = unbound
store_end = keep_state


@inlined
def equal_steps(run: Run) -> float:
    """Implement the hook `next_end_time` for run.total steps of equal length."""
    k = run.steps + 1
    return run.t_end if k == run.total else k * run.h


@inlined
def load_ends(run: Run, params: Array, work: Array, t_new: float, stored: Array) -> None:
    """Implement the hook `load_step` for methods that need only the ends of a stored step."""


@dataclass(frozen=True)
class Hooks:
    """The compiled functions that define the steps of a method.

    All hooks take the registers of the run first, then params (p,) and the work rows if they need
    them. t_new is the time at the end of the current step [s].

    Attributes:
        begin_run: (run, params, work, end_times, end_states): store the initial state, which is in
            row Y, and prepare the first step. Returns DONE, or the reason of a failure.
        next_end_time: (run): return the time at which the next step ends [s].
        attempt_step: (run, params, work, t_new): compute a step from row Y to row NEW. Returns
            DONE; AGAIN, with the next step in run.h; WANTED; or the reason of a failure.
        accept_step: (run, work, t_new): continue from the end of the step, and choose the length of
            the next step.
        write_state: (run, params, work, time, t_new, out): write the state (n,) at a time from
            run.t to t_new, NaN if it is not computed, with normalised quaternions. run.known
            states the contents of the work rows. Returns DONE, AGAIN, WANTED, or the reason of a
            failure.
        load_step: (run, params, work, t_new, stored): restore the work rows of a step whose ends
            are in rows Y and NEW; `stored` was stored at its end, (n + …,).
        store_end: (run, work, t, end_times, end_states): store the state at the step end t.
    """

    begin_run: Callable[..., int]
    next_end_time: Callable[..., float]
    attempt_step: Callable[..., int]
    accept_step: Callable[..., None]
    write_state: Callable[..., int]
    load_step: Callable[..., None] = load_ends
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
    """Integrate until the end time, a pause, a full array of step ends, or a failure.

    Args:
        runs: Registers of the run, (1,).
        params: Parameters, (p,).
        work: Work rows, with the state in row Y.
        times: Sorted report times, (T,) [s].
        out: States at the report times, (T, n), output.
        end_times: Times of the step ends, (K,) [s], output.
        end_states: Stored states, (K, …), output.
    Returns:
        DONE, PAUSED, FULL, WANTED, or the reason of a failure.
    """
    run: Run = runs[0]
    if not run.begun:
        status: int = begin_run(run, params, work, end_times, end_states)
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
    """Write the states at the report times up to t_new.

    Args:
        run: Registers of the run.
        params: Parameters, (p,).
        work: Work rows.
        times: Sorted report times, (T,) [s].
        out: States at the report times, (T, n), output.
        t_new: End of the step [s].
    Returns:
        DONE, or the status of the first state that was not computed.
    """
    run.known = STEP
    while run.next < times.shape[0] and times[run.next] <= t_new:
        j = run.next
        status: int = write_state(run, params, work, times[j], t_new, out[j])
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
    """Recompute the states at given times from stored steps, NaN where this fails.

    Args:
        runs: Registers of the run, (1,).
        params: Parameters, (p,).
        work: Work rows.
        times: Sorted times, (T,) [s].
        out: States, (T, n), output.
        end_times: Times of the step ends, (K,) [s].
        end_states: Stored states, (K, …).
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
            load_step(run, params, work, end_times[k + 1], end_states[k + 1])
        write_state(run, params, work, times[j], end_times[k + 1], out[j])


@compiled
def step_at(time: float, k: int, end_times: Array) -> int:
    """Return the index of the step that contains a time (its end included), starting at step k."""
    while k + 1 < end_times.shape[0] - 1 and time > end_times[k + 1]:
        k += 1
    return k


class Batch(NamedTuple):
    """Runs of one kernel; arrays have the member as first axis.

    Attributes:
        params: Parameters, (N, p).
        y0: Initial states, (N, n).
        ends: End times, (N,) [s].
        times: Sorted report times, (N, T), or (1, T) if all members have the same; rows of
            different lengths end with infinity [s].
        y: States at the report times, (N, T, n).
        outcomes: Outcomes of the members, (N,) of OUTCOME.
        stop: Flag, (1,); a nonzero value interrupts all threads.
        no_times: Empty array in place of times of step ends, (0,).
        no_knots: Empty array in place of states at step ends, (0, n).
    """

    params: Array
    y0: Array
    ends: Array
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
    """Integrate members first to last − 1 of a batch.

    Args:
        batch: Members, and the arrays of their results.
        first_run: Registers of a run before its first step, (1,).
        runs: Registers of the current run, (1,).
        work: Work rows.
        first: First member.
        last: Index after the last member.
    Returns:
        The member that needs the derivative of the kernel to continue, or `last`.
    """
    run: Run = runs[0]
    for member in range(first, last):
        if run.member != member:
            runs[0] = first_run[0]
            run.member, run.t_end = member, batch.ends[member]
            for i in range(run.n):
                work[Y, i] = batch.y0[member, i]
        status = PAUSED
        while status == PAUSED:
            if batch.stop[0] != 0:
                return last
            status = advance(
                runs, batch.params[member], work, batch.times[member % batch.times.shape[0]],
                batch.y[member],
                batch.no_times, batch.no_knots,
            )  # fmt: skip
        if status == WANTED:
            return member
        outcome = batch.outcomes[member]
        outcome.t, outcome.status, outcome.entry = run.t, status, run.entry
        outcome.steps, outcome.rejected = run.steps, run.rejected
        outcome.evaluations = run.evaluations
    return last


def through(
    runs: Runs,
    first_run: Runs,
    params: Array,
    lengths: Array,
    work: Array,
    no_times: Array,
    no_states: Array,
    end_times: Array,
    end_states: Array,
    first: NDArray[np.int64],
    place: NDArray[np.int64],
) -> int:
    """Integrate over successive parts of time, each with its own parameters.

    Args:
        runs: Registers of the parts, (S,), output; a part that has not begun has no end time.
        first_run: Registers of a run before its first step, (1,).
        params: Parameters of the parts, (S, p).
        lengths: Lengths of the parts, (S,) [s].
        work: Work rows, with the state in row Y.
        no_times: Empty array in place of report times, (0,).
        no_states: Empty array in place of states at report times, (0, n).
        end_times: Times of the step ends of all parts, (K,) [s], output.
        end_states: Stored states of all parts, (K, …), output.
        first: Index of the first step end of each part, (S + 1,), output.
        place: Index of the current part, (1,).
    Returns:
        DONE, or the status of the current part.
    """
    spent = 0
    for k in range(place[0], lengths.shape[0]):
        run: Run = runs[k]
        start = first[k]
        if end_times.shape[0] < start + 2:
            return FULL
        if run.t_end == 0.0:
            runs[k] = first_run[0]
            run.t_end = lengths[k]
        status: int = advance(
            runs[k : k + 1], params[k], work, no_times, no_states, end_times[start:],
            end_states[start:],
        )  # fmt: skip
        if status != DONE:
            return status
        last = start + run.steps
        for i in range(run.n):
            work[Y, i] = end_states[last, i]
        unit_alone(work[Y], quaternions_of(run))
        first[k + 1] = last + 1
        place[0] = k + 1
        spent += run.evaluations
        if spent >= run.budget and k + 1 < lengths.shape[0]:
            return PAUSED
    return DONE


@dataclass(frozen=True)
class Loops:
    """The compiled loops of a method: copies of the functions with the same names."""

    advance: Callable[..., int]
    recall: Callable[..., None]
    members: Callable[..., int]
    through: Callable[..., int]


def loops(name: str, hooks: Hooks) -> Loops:
    """Compile the loops of a method.

    Args:
        name: Unique name of the method, the same in every process.
        hooks: Hooks of the method.
    Returns:
        The loops.
    """
    bindings = vars(hooks)
    # `advance` calls it twice, and inlined twice it would take longer to compile.
    bound_report = compiled(bind_globals(report, f"{name}_report", **bindings))
    bound_advance = compiled(
        bind_globals(advance, f"{name}_advance", **bindings, report=bound_report)
    )
    return Loops(
        bound_advance,
        compiled(bind_globals(recall, f"{name}_recall", **bindings)),
        compiled(bind_globals(members, f"{name}_members", advance=bound_advance)),
        compiled(bind_globals(through, f"{name}_through", advance=bound_advance)),
    )


@dataclass(frozen=True)
class Stepper:
    """The compiled loops of a method, and its memory needs.

    Attributes:
        loops: Compiled loops.
        rows: Function that allocates the work rows for n entries of the state.
        kept: Number of floats stored at a step end per entry of the state.
        stages: Number of additional floats per entry if stages are stored, 0 if stages cannot be
            stored.
        needs_tangent: Whether the method always needs the derivative of the kernel.
        newton_rows: Function that allocates the work rows with space for Newton's method; None if
            the method has the same rows with it.
    """

    loops: Loops
    rows: Callable[[int], Array]
    kept: int = 1
    stages: int = 0
    needs_tangent: bool = False
    newton_rows: Callable[[int], Array] | None = None

    def work(self, n: int, *, tangent: bool = False) -> Array:
        """Allocate the work rows (…, stride) for n entries of the state."""
        if self.newton_rows is None or not (tangent or self.needs_tangent):
            return self.rows(n)
        return self.newton_rows(n)

    def widened(self, n: int, work: Array) -> Array:
        """Copy `work` to rows that also have space for Newton's method."""
        larger = self.work(n, tangent=True)
        larger[: len(work)] = work
        return larger
