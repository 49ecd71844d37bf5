"""The loop over members in lanes: each has its own step, and those at their end are replaced.

Members are taken from a queue that all threads share, so many at a time as there are lanes, and
made ready together: their rates and first steps are those of vectors, too.  What a member does
is worked out in its lane alone: its numbers are the same beside any others, in any lane.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array
from ..explicit.runge_kutta import BEGIN_RATE, END_RATE, RATES
from ..stepping.compiling import compiled
from ..stepping.kernel_call import call
from ..stepping.run_record import DONE, NOT_FINITE, TOO_MANY, UNDERFLOW, Run, Runs
from ..stepping.state_rows import NEW, Y, unit_alone
from ..stepping.step_loop import Batch
from .lane_steps import (
    READY_RATE,
    READY_Y,
    accept,
    between,
    finite,
    first_step,
    get,
    next_step,
    prepare,
    put,
    same,
    unit,
)
from .vectors import bits, choose, take

# Rows of the registers of lanes, as floats: time and next step [s]; whether the last trial was
# rejected; counts; the next time to report [s] and its index; which number was not finite, −1
# for none; whether there is a member in the lane, and which.
TIME, STEP, AGAIN, STEPS, REJECTED, EVALUATIONS = range(6)
NEXT_TIME, NEXT, ENTRY, LIVE, MEMBER, REGISTERS = range(6, 12)
# Rows of the registers of what is ready: first step, member, number that is not finite; in the
# first lane of the others, how many are ready and how many of them are in lanes.
FIRST_STEP, READY_MEMBER, READY_ENTRY, COUNT, USED, READY_REGISTERS = range(6)

_EPS = float(np.finfo(float).eps)


class Room(NamedTuple):
    """The room of a thread.  Rows of lanes, and columns of parameters in lanes, (p width,).

    work: states and rates.  params: theirs.  own: registers.  ready, ready_params, ready_own: of
    members that wait for a lane.
    """

    work: Array
    params: Array
    own: Array
    ready: Array
    ready_params: Array
    ready_own: Array


# --- what a tableau and a width give: see lane_steps ----------------------------------------


WIDTH, STAGES, OUT = 1, 1, 0
BEGUN, AT_STEP, AT_END, AT_DENSE = 2.0, 1.0, 1.0, 0.0  # evaluations


def _of_tableau(*arguments: Any) -> Any:
    raise NotImplementedError


fill_step = fill_end = fill_errors = fill_dense = estimate = _of_tableau


# --- members come and go -------------------------------------------------------------------


def make_ready(run: Run, batch: Batch, queue: NDArray[np.int64], room: Room, most: int) -> int:
    """Take members from the queue, at most so many, and make them ready; return how many."""
    ready, params, own = room.ready, room.ready_params, room.ready_own
    size = batch.y0.shape[0]
    first: int = take(queue, most)
    count: int = min(most, size - first)
    if count <= 0:
        own[COUNT, 0] = own[USED, 0] = 0.0
        return 0
    for lane in range(WIDTH):
        member = first + min(lane, count - 1)
        own[READY_MEMBER, lane] = member
        for i in range(run.n):
            ready[READY_Y, i * WIDTH + lane] = batch.y0[member, i]
        for i in range(batch.params.shape[1]):
            params[i * WIDTH + lane] = batch.params[member, i]
    call(run.address, ready[READY_Y], params, ready[READY_RATE])
    unit(run, ready, READY_Y, READY_RATE, same(0.0) == 0.0)
    put(own, FIRST_STEP, 0, first_step(run, params, ready))
    for lane in range(count):
        own[READY_ENTRY, lane] = -1.0
        for i in range(run.n):
            rate = ready[READY_RATE, i * WIDTH + lane]
            if rate - rate != 0.0:
                own[READY_ENTRY, lane] = i
                break
    own[COUNT, 0], own[USED, 0] = count, 0.0
    return count


def enter(
    run: Run, batch: Batch, queue: NDArray[np.int64], room: Room, lane: int, most: int
) -> bool:
    """Put the next member into a lane; return whether there is one."""
    work, own, ready, ready_own = room.work, room.own, room.ready, room.ready_own
    while True:
        used_up = ready_own[USED, 0] >= ready_own[COUNT, 0]
        if used_up and make_ready(run, batch, queue, room, most) == 0:
            # The lane idles: steps of length zero from a state whose numbers are finite.
            own[LIVE, lane] = own[TIME, lane] = own[STEP, lane] = 0.0
            own[NEXT_TIME, lane] = np.inf
            for i in range(run.n):
                work[Y, i * WIDTH + lane] = batch.y0[0, i]
                work[BEGIN_RATE, i * WIDTH + lane] = 0.0
            for i in range(batch.params.shape[1]):
                room.params[i * WIDTH + lane] = batch.params[0, i]
            return False
        k = int(ready_own[USED, 0])
        ready_own[USED, 0] += 1.0
        member = int(ready_own[READY_MEMBER, k])
        entry = int(ready_own[READY_ENTRY, k])
        if entry >= 0:
            end = batch.outcomes[member]
            end.t, end.entry, end.evaluations = 0.0, entry, 1
            end.status = NOT_FINITE
            continue
        for i in range(run.n):
            work[Y, i * WIDTH + lane] = ready[READY_Y, i * WIDTH + k]
            work[BEGIN_RATE, i * WIDTH + lane] = ready[READY_RATE, i * WIDTH + k]
        for i in range(batch.params.shape[1]):
            room.params[i * WIDTH + lane] = room.ready_params[i * WIDTH + k]
        for row in range(REGISTERS):
            own[row, lane] = 0.0
        own[STEP, lane] = ready_own[FIRST_STEP, k]
        own[EVALUATIONS, lane] = BEGUN
        own[ENTRY, lane] = -1.0
        own[LIVE, lane], own[MEMBER, lane] = 1.0, member
        own[NEXT_TIME, lane] = batch.times[0] if batch.times.shape[0] else np.inf
        while own[NEXT_TIME, lane] <= 0.0:
            write(run, batch, room, lane, Y)
        return True


def write(run: Run, batch: Batch, room: Room, lane: int, row: int) -> None:
    """Write the state of a row down as that at the next time of a lane."""
    own = room.own
    j, count = int(own[NEXT, lane]), batch.times.shape[0]
    out = batch.y[int(own[MEMBER, lane]), j]
    for i in range(run.n):
        out[i] = room.work[row, i * WIDTH + lane]
    unit_alone(out, run.quaternion)
    own[NEXT, lane] = j + 1
    own[NEXT_TIME, lane] = batch.times[j + 1] if j + 1 < count else np.inf


def culprit(run: Run, work: Array, lane: int) -> int:
    """Return the entry that was the first not to be finite in a trial step, −1 for none."""
    for k in range(STAGES + 2):
        row = BEGIN_RATE
        if 0 < k < STAGES:
            row = RATES + k - 1
        elif k >= STAGES:
            row = NEW if k == STAGES else END_RATE
        for i in range(run.n):
            value = work[row, i * WIDTH + lane]
            if value - value != 0.0:
                return i
    return -1


# --- the loop ------------------------------------------------------------------------------


def lane_members(
    batch: Batch, unbegun: Runs, queue: NDArray[np.int64], room: Room, most: int
) -> None:
    """Run members of the queue until it is empty, or batch.stop is not zero.

    unbegun: registers of a run that has not begun.  most: how many to take from the queue at once.
    """
    run: Run = unbegun[0]
    work, own, params, times = room.work, room.own, room.params, batch.times
    room.ready_own[COUNT, 0] = room.ready_own[USED, 0] = 0.0
    live = 0
    for lane in range(WIDTH):
        live += enter(run, batch, queue, room, lane, most)
    while live > 0 and batch.stop[0] == 0:
        t, planned = get(own, TIME, 0), get(own, STEP, 0)
        t_new = choose(t + 1.01 * planned >= run.t_end, run.t_end, t + planned)
        t_new = choose(get(own, LIVE, 0) == 1.0, t_new, 0.0)
        h = t_new - t
        fill_step(run.address, params, work, h)
        fill_errors(run.address, params, work, same(1.0))
        error = estimate(run, work, h)
        fill_end(run.address, params, work, h)
        small = error <= 1.0
        taken = small & finite(run, work, END_RATE)
        counted = get(own, EVALUATIONS, 0) + choose(small, AT_STEP + AT_END, AT_STEP)
        next_time = get(own, NEXT_TIME, 0)
        inside = taken & (next_time < t_new)
        if bits(inside) != 0:
            fill_dense(run.address, params, work, h)
            prepare(run, work, h)
            counted = choose(inside, counted + AT_DENSE, counted)
            due = bits(inside)
            while due != 0:
                between(run, work, (next_time - t) / h, OUT)
                for lane in range(WIDTH):
                    if (due >> lane) & 1:
                        write(run, batch, room, lane, OUT)
                next_time = get(own, NEXT_TIME, 0)
                due = bits(taken & (next_time < t_new))
        due = bits(taken & (next_time <= t_new))
        for lane in range(WIDTH if due else 0):
            if (due >> lane) & 1:
                shown = int(own[NEXT, lane])
                end = times[shown]
                while own[NEXT_TIME, lane] <= end:
                    write(run, batch, room, lane, NEW)
        odd = bits(~taken & ~((error > 1.0) & (error < np.inf)))
        for lane in range(WIDTH if odd else 0):
            if (odd >> lane) & 1:
                own[ENTRY, lane] = culprit(run, work, lane)
        accept(run, work, taken)
        again = get(own, AGAIN, 0) == 1.0
        step = next_step(error, h, taken, again, run.max_step)
        put(own, ENTRY, 0, choose(taken & ~again, -1.0, get(own, ENTRY, 0)))
        t = choose(taken, t_new, t)
        steps = get(own, STEPS, 0) + choose(taken, 1.0, 0.0)
        rejected = get(own, REJECTED, 0) + choose(taken, 0.0, 1.0)
        put(own, TIME, 0, t)
        put(own, STEP, 0, step)
        put(own, AGAIN, 0, choose(taken, 0.0, same(1.0)))
        put(own, STEPS, 0, steps)
        put(own, REJECTED, 0, rejected)
        put(own, EVALUATIONS, 0, counted)
        spent = steps + rejected >= float(run.max_steps)
        over = bits(
            (get(own, LIVE, 0) == 1.0) & ((t >= run.t_end) | spent | (0.1 * step <= _EPS * t))
        )
        for lane in range(WIDTH if over else 0):
            if (over >> lane) & 1:
                leave(run, batch, own, lane)
                live -= 1
                live += enter(run, batch, queue, room, lane, most)


@compiled
def leave(run: Run, batch: Batch, own: Array, lane: int) -> None:
    """Write down what became of the member in a lane."""
    end = batch.outcomes[int(own[MEMBER, lane])]
    end.t, end.entry = own[TIME, lane], int(own[ENTRY, lane])
    end.steps, end.rejected = int(own[STEPS, lane]), int(own[REJECTED, lane])
    end.evaluations = int(own[EVALUATIONS, lane])
    if own[TIME, lane] >= run.t_end:
        end.status = DONE
    elif own[STEPS, lane] + own[REJECTED, lane] >= run.max_steps:
        end.status = TOO_MANY
    else:
        end.status = NOT_FINITE if end.entry >= 0 else UNDERFLOW
