"""integrate_many(): one kernel from many initial states, on several threads."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import dataclass
from itertools import pairwise
from threading import Lock

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..common.arrays import Array, as_floats, freeze, positive, read_only
from ..common.errors import InputError, ShapeError
from . import dop853, rkmk4
from .integrate import Canonical, Tangent, check_kernel, check_state, checked_times, want
from .machine.kernel_call import compiled
from .machine.registers import (
    DIVERGED,
    DONE,
    ENTRY,
    EVALUATIONS,
    NOT_FINITE,
    PAUSED,
    REJECTED,
    STEPS,
    TOO_MANY,
    UNDERFLOW,
    WANTED,
    Counts,
    N,
    T,
)
from .methods import DOP853, RKMK4, Method
from .steppers import registers, stepper_of, with_tangent, work_rows

STATUS = {
    DONE: "done",
    UNDERFLOW: "step size underflow",
    DIVERGED: "without a solution of its implicit step",
    NOT_FINITE: "not finite",
    TOO_MANY: "too many steps",
}
_LOOK = 0.1  # s between looks at how far the threads are
_SHARES_PER_THREAD = 8  # so that threads with short runs take over from those with long ones


@dataclass(frozen=True)
class Solutions:
    """Many runs, member first.

    times: (T,) [s].  y: (N, T, n), NaN at the times that a run has not reached.
    status: (N,), 0 or the key in STATUS of what stopped a run.  end: (N,) the last time
    reached [s].  entry: (N,) which number was not finite, −1 if none.
    steps, rejected, evaluations: (N,).
    """

    method: Method
    times: Array
    y: Array
    status: NDArray[np.int64]
    end: Array
    entry: NDArray[np.int64]
    steps: NDArray[np.int64]
    rejected: NDArray[np.int64]
    evaluations: NDArray[np.int64]

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def ok(self) -> NDArray[np.bool_]:
        """Which runs came to their end, (N,)."""
        return np.asarray(self.status == DONE)


def integrate_many(
    method: Method,
    address: int,
    params: ArrayLike,
    y0: ArrayLike,
    t_end: float,
    times: ArrayLike,
    quaternion: int = -1,
    threads: int | None = None,
    tangent: Tangent | None = None,
    canonical: Canonical = (0, 0),
    progress: Callable[[float], None] | None = None,
) -> Solutions:
    """Integrate ẏ = f(y, params[i]) from y0[i] for every i, each as `integrate` would.

    params: (N, p).  y0: (N, n).  times: (T,) sorted, within [0, t_end].
    threads: as many as there are processors if None; the numbers do not depend on it.
    params and y0 are not to be changed meanwhile.  tangent, canonical: as for
    `integrate`.  progress: called with the part of the members that is done.
    A run that fails has a status and leaves the others alone.  Raises InputError.
    """
    end = positive(t_end, "t_end")
    check_kernel(address)
    start = read_only(np.ascontiguousarray(as_floats(y0, "y0")).view())
    check_state(start, quaternion, "y0", 2)
    size, n = start.shape
    frozen = read_only(np.ascontiguousarray(as_floats(params, "params")).view())
    if frozen.ndim != 2 or frozen.shape[0] != size:
        raise ShapeError(f"params must have shape ({size}, p) as y0 has, got {frozen.shape}")
    asked = checked_times(times, end, ordered=True)
    if threads is None:
        threads = len(os.sched_getaffinity(0))
    if isinstance(threads, bool) or not isinstance(threads, int) or threads < 1:
        raise InputError(f"threads must be a whole number above zero, got {threads!r}")

    real, count = registers(method, n, end, quaternion, canonical)
    y = np.full((size, len(asked), n), np.nan)
    reached, tally = np.zeros(size), np.full((size, 5), PAUSED, dtype=np.int64)
    stop = np.zeros(1, dtype=np.int64)
    loops = {DOP853: 0, RKMK4: 1}
    family = loops.get(type(method), -1)

    lock = Lock()

    def derivative(count: Counts) -> None:
        with lock:  # what makes a kernel is not for several threads
            want(tangent, method, count)

    def share(first: int, last: int) -> None:
        if family < 0:
            _one_by_one(
                method, derivative, address, frozen, start, first, last, real, count,
                asked, y, reached, tally, stop,
            )  # fmt: skip
            return
        work = work_rows(method, n)
        members(
            family, address, frozen, start, first, last, real.copy(), count.copy(), real, count,
            work, asked, y, reached, tally, stop,
        )  # fmt: skip

    threads = min(threads, max(size, 1))
    bounds = np.linspace(0, size, min(size, threads * _SHARES_PER_THREAD) + 1).astype(int)
    with ThreadPoolExecutor(threads) as pool:
        futures = [pool.submit(share, int(a), int(b)) for a, b in pairwise(bounds)]
        try:
            look = None if progress is None else _LOOK
            ended, running = wait(futures, look, FIRST_EXCEPTION)
            while running and progress is not None and not any(f.exception() for f in ended):
                progress(float(np.mean(tally[:, 0] != PAUSED)))
                ended, running = wait(futures, look, FIRST_EXCEPTION)
            for future in ended:
                future.result()
        except BaseException:
            stop[0] = 1  # the threads see it at their next pause
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return Solutions(
        method=method,
        times=asked,
        y=y,
        status=tally[:, 0].copy(),
        end=reached,
        entry=tally[:, 1].copy(),
        steps=tally[:, 2].copy(),
        rejected=tally[:, 3].copy(),
        evaluations=tally[:, 4].copy(),
    )


def _one_by_one(
    method: Method,
    derivative: Callable[[Counts], None],
    address: int,
    params: Array,
    y0: Array,
    first: int,
    last: int,
    fresh_real: Array,
    fresh_count: Counts,
    times: Array,
    y: Array,
    reached: Array,
    tally: Counts,
    stop: Counts,
) -> None:
    """Run members as `members` does, in a loop of Python's; a run is compiled all the same."""
    no_times, no_states = reached[:0], y[0, :0]
    stepper, n = stepper_of(method), y0.shape[1]
    for member in range(first, last):
        real, count = fresh_real.copy(), fresh_count.copy()
        work = work_rows(method, n)
        work[stepper.state, :n] = y0[member]
        status = PAUSED
        while status in (PAUSED, WANTED):
            if stop[0] != 0:
                return
            if status == WANTED:
                derivative(count)
                work = with_tangent(method, n, work)
            status = stepper.advance(
                address, params[member], real, count, work, times, y[member], no_times, no_states
            )
        reached[member] = real[T]
        tally[member] = (
            status, count[ENTRY], count[STEPS], count[REJECTED], count[EVALUATIONS],
        )  # fmt: skip


@compiled
def members(
    family: int,
    address: int,
    params: Array,
    y0: Array,
    first: int,
    last: int,
    real: Array,
    count: Counts,
    fresh_real: Array,
    fresh_count: Counts,
    work: Array,
    times: Array,
    y: Array,
    reached: Array,
    tally: Counts,
    stop: Counts,
) -> None:
    """Run members first to last − 1.  family: 0 for DOP853, 1 for RKMK4.

    tally: (N, 5) status, entry, steps, rejected, evaluations.  stop: (1,) not 0 to give up.
    """
    no_times, no_states = reached[:0], y[0, :0]
    for member in range(first, last):
        real[:] = fresh_real
        count[:] = fresh_count
        row = dop853.Y if family == 0 else rkmk4.Y
        for i in range(count[N]):
            work[row, i] = y0[member, i]
        status = PAUSED
        while status == PAUSED:
            if stop[0] != 0:
                return
            if family == 0:
                status = dop853.advance(
                    address, params[member], real, count, work, times, y[member],
                    no_times, no_states,
                )  # fmt: skip
            else:
                status = rkmk4.advance(
                    address, params[member], real, count, work, times, y[member],
                    no_times, no_states,
                )  # fmt: skip
        reached[member] = real[T]
        tally[member, 0], tally[member, 1] = status, count[ENTRY]
        tally[member, 2], tally[member, 3] = count[STEPS], count[REJECTED]
        tally[member, 4] = count[EVALUATIONS]
