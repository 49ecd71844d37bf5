"""integrate_many(): one kernel from many initial states, on several threads."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from threading import Lock

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..common.arrays import Array, as_floats, freeze, positive, read_only
from ..common.errors import InputError, ShapeError
from .integrate import (
    Canonical,
    Tangent,
    begun_by,
    check_kernel,
    check_state,
    checked_times,
    give_tangent,
)
from .methods.method import Method
from .stepping.run_record import (
    DIVERGED,
    DONE,
    NOT_FINITE,
    PAUSED,
    TOO_MANY,
    UNDERFLOW,
    copied,
)
from .stepping.step_loop import OUTCOME, Batch

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
        """Flags of the runs that came to their end, (N,)."""
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
    asked = checked_batch(address, params, y0, t_end, times, quaternion, threads)
    batch, size = asked.batch, len(asked.batch.y0)
    n = asked.batch.y0.shape[1]
    stepper = method.stepper()
    unbegun = begun_by(method, address, n, asked.end, quaternion, canonical)
    if stepper.needs_tangent:
        give_tangent(tangent, method, unbegun)
    lock = Lock()

    def share(first: int, last: int) -> None:
        run, work = copied(unbegun), stepper.work(n)
        while (first := stepper.loops.members(batch, unbegun, run, work, first, last)) < last:
            with lock:  # what makes a kernel is not for several threads
                give_tangent(tangent, method, run)
            work = stepper.widened(n, work)

    bounds = np.linspace(0, size, min(size, asked.threads * _SHARES_PER_THREAD) + 1).astype(int)
    shares = [partial(share, int(a), int(b)) for a, b in pairwise(bounds)]
    over_threads(shares, asked, progress)
    return solutions(method, batch)


@dataclass(frozen=True)
class Asked:
    """Many runs as they were asked for.  end: time [s].  threads: how many work on the batch."""

    batch: Batch
    end: float
    threads: int


def checked_batch(
    address: int,
    params: ArrayLike,
    y0: ArrayLike,
    t_end: float,
    times: ArrayLike,
    quaternion: int,
    threads: int | None,
) -> Asked:
    """Return what `integrate_many` was asked for, with room for the results.  Raises InputError."""
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
    outcomes = np.zeros(size, OUTCOME)
    outcomes["status"] = PAUSED
    batch = Batch(
        params=frozen,
        y0=start,
        times=asked,
        y=np.full((size, len(asked), n), np.nan),
        outcomes=outcomes,
        stop=np.zeros(1, dtype=np.int64),
        no_times=np.empty(0),
        no_knots=np.empty((0, n)),
    )
    return Asked(batch, end, min(threads, max(size, 1)))


def over_threads(
    shares: Sequence[Callable[[], None]], asked: Asked, progress: Callable[[float], None] | None
) -> None:
    """Do shares of the work on several threads, and tell how many members are done."""
    batch = asked.batch
    with ThreadPoolExecutor(asked.threads) as pool:
        futures = [pool.submit(share) for share in shares]
        try:
            look = None if progress is None else _LOOK
            ended, running = wait(futures, look, FIRST_EXCEPTION)
            while running and progress is not None and not any(f.exception() for f in ended):
                progress(float(np.mean(batch.outcomes["status"] != PAUSED)))
                ended, running = wait(futures, look, FIRST_EXCEPTION)
            for future in ended:
                future.result()
        except BaseException:
            batch.stop[0] = 1  # the threads see it at their next pause
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def solutions(method: Method, batch: Batch) -> Solutions:
    """Return the solutions of a batch that has been worked on."""
    outcomes = batch.outcomes
    return Solutions(
        method=method,
        times=batch.times,
        y=batch.y,
        status=outcomes["status"].copy(),
        end=outcomes["t"].copy(),
        entry=outcomes["entry"].copy(),
        steps=outcomes["steps"].copy(),
        rejected=outcomes["rejected"].copy(),
        evaluations=outcomes["evaluations"].copy(),
    )
