"""integrate_many(): integrate one kernel from many initial states, on several threads."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from threading import Lock, local

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..common.arrays import Array, FrozenArrays, as_floats, positive, read_only
from ..common.errors import InputError, ShapeError
from ..common.machine_code import available_processors
from .integrate import Tangent, begun_by, check_kernel, check_state, checked_times, give_tangent
from .methods.method import Method, stepper_of
from .stepping.run_state import (
    DIVERGED,
    DONE,
    NOT_CANONICAL,
    NOT_FINITE,
    PAUSED,
    TOO_MANY,
    UNDERFLOW,
    Canonical,
    Quaternions,
    copied,
)
from .stepping.step_loop import OUTCOME, Batch, Stepper

STATUS = {
    DONE: "done",
    UNDERFLOW: "step size underflow",
    DIVERGED: "without a solution of its implicit step",
    NOT_FINITE: "not finite",
    TOO_MANY: "too many steps",
}
_LOOK = 0.1  # interval of progress reports [s]
# More than one share per thread, so that threads with short runs can take further shares.
_SHARES_PER_THREAD = 8
_kept = local()  # `pool`: the process and the pool with one thread of a calling thread


@dataclass(frozen=True)
class Solutions(FrozenArrays):
    """Results of a batch of runs; all arrays have the member as first axis.

    Attributes:
        method: Method of the runs.
        times: Report times, (T,), or (N, T) if each member has its own [s].
        y: States, (N, T, n); NaN at times that a run did not reach.
        status: Outcome of each run, (N,): 0 or the key in STATUS of the reason it stopped.
        end: Last time reached, (N,) [s].
        entry: Index of the entry that was not finite, (N,); −1 if all entries were finite.
        steps: Accepted steps, (N,).
        rejected: Rejected steps, (N,).
        evaluations: Evaluations of the kernel, (N,).
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

    @property
    def ok(self) -> NDArray[np.bool_]:
        """Whether each run reached the end, (N,)."""
        return np.asarray(self.status == DONE)


def integrate_many(
    method: Method,
    address: int,
    params: ArrayLike,
    y0: ArrayLike,
    t_end: ArrayLike,
    times: ArrayLike,
    quaternions: Quaternions = (0, 0),
    threads: int | None = None,
    tangent: Tangent | None = None,
    canonical: Canonical = NOT_CANONICAL,
    progress: Callable[[float], None] | None = None,
    stepper: Stepper | None = None,
) -> Solutions:
    """Integrate ẏ = f(y, params[i]) from y0[i] for all members i, each as `integrate` does.

    A failing run reports a status and does not affect the others. params and y0 must not be changed
    during the call.

    Args:
        method: Method with its options.
        address: Address of the kernel.
        params: Parameters, (N, p).
        y0: Initial states, (N, n).
        t_end: End time, or one for each member, (N,) [s].
        times: Sorted report times within [0, t_end], (T,), or a row for each member, (N, T); rows
            with fewer times end with infinity [s].
        quaternions: As for `integrate`.
        threads: Number of threads, None for all processors. Results do not depend on this number.
        tangent: As for `integrate`.
        canonical: As for `integrate`.
        progress: Called with the finished fraction of the members.
        stepper: Compiled loops of the method; None for those of `integrate`.
    Returns:
        States, outcomes and statistics of all runs.
    Raises:
        InputError: An argument is invalid.
    """
    asked = checked_batch(address, params, y0, t_end, times, quaternions, threads)
    batch, size = asked.batch, len(asked.batch.y0)
    n = asked.batch.y0.shape[1]
    stepper = stepper or stepper_of(method)
    unbegun = begun_by(method, address, n, asked.end, quaternions, canonical)
    if stepper.needs_tangent:
        give_tangent(tangent, method, unbegun)
    lock = Lock()

    def share(first: int, last: int) -> None:
        run, work = copied(unbegun), stepper.work(n)
        while (first := stepper.loops.members(batch, unbegun, run, work, first, last)) < last:
            with lock:  # the compilation of kernels is not thread-safe
                give_tangent(tangent, method, run)
            work = stepper.widened(n, work)

    bounds = np.linspace(0, size, min(size, asked.threads * _SHARES_PER_THREAD) + 1).astype(int)
    shares = [partial(share, int(a), int(b)) for a, b in pairwise(bounds)]
    over_threads(shares, asked, progress)
    return solutions(method, batch)


@dataclass(frozen=True)
class Asked:
    """A validated request for many runs.

    Attributes:
        batch: Members, and the arrays of their results.
        end: Latest end time [s].
        threads: Number of threads.
    """

    batch: Batch
    end: float
    threads: int


def checked_batch(
    address: int,
    params: ArrayLike,
    y0: ArrayLike,
    t_end: ArrayLike,
    times: ArrayLike,
    quaternions: Quaternions,
    threads: int | None,
) -> Asked:
    """Validate the arguments of `integrate_many`, and allocate the results.

    Args:
        address: Address of the kernel.
        params: Parameters, (N, p).
        y0: Initial states, (N, n).
        t_end: End time, or one for each member, (N,) [s].
        times: Sorted report times within [0, t_end], (T,), or a row for each member, (N, T); rows
            with fewer times end with infinity [s].
        quaternions: As for `integrate`.
        threads: Number of threads, None for all processors.
    Returns:
        The request.
    Raises:
        InputError: An argument is invalid.
        ShapeError: Shapes do not fit, or a number is not finite.
    """
    check_kernel(address)
    states = read_only(np.ascontiguousarray(as_floats(y0, "y0")).view())
    check_state(states, quaternions, "y0", 2)
    size, n = states.shape
    checked_params = read_only(np.ascontiguousarray(as_floats(params, "params")).view())
    if checked_params.ndim != 2 or checked_params.shape[0] != size:
        raise ShapeError(
            f"params must have shape ({size}, p), one row per row of y0, got {checked_params.shape}"
        )
    ends = read_only(np.broadcast_to(as_floats(t_end, "t_end"), size).copy())
    if np.ndim(t_end) == 0:
        end = positive(t_end, "t_end")  # type: ignore[arg-type]
    else:
        end = max((positive(value, "t_end") for value in ends.tolist()), default=1.0)
    report_times = _rows_of_times(times, ends, end)
    if threads is None:
        threads = available_processors()
    if isinstance(threads, bool) or not isinstance(threads, int) or threads < 1:
        raise InputError(f"threads must be a whole number above zero, got {threads!r}")
    outcomes = np.zeros(size, OUTCOME)
    outcomes["status"] = PAUSED
    batch = Batch(
        params=checked_params,
        y0=states,
        ends=ends,
        times=report_times,
        y=np.full((size, report_times.shape[1], n), np.nan),
        outcomes=outcomes,
        stop=np.zeros(1, dtype=np.int64),
        no_times=np.empty(0),
        no_knots=np.empty((0, n)),
    )
    return Asked(batch, end, min(threads, max(size, 1)))


def _rows_of_times(times: ArrayLike, ends: Array, end: float) -> Array:
    """Return report times as rows, (1, T) or (N, T).

    Args:
        times: Report times, (T,), or (N, T) with infinity after the last one of each row [s].
        ends: End times of the members, (N,) [s].
        end: Latest end time [s].
    Returns:
        The rows.
    Raises:
        ShapeError: There is not one row for each member.
        InputError: Times are not sorted, or outside of the run of their member.
    """
    if np.ndim(times) != 2:
        return read_only(np.array(checked_times(times, end, ordered=True))[None])
    rows = np.array(times, float)
    if len(rows) != len(ends):
        raise ShapeError(f"times must have {len(ends)} rows, one for each member, got {len(rows)}")
    later = np.where(np.isinf(rows), ends[:, None], rows)
    if not ((later >= 0.0).all() and (later <= ends[:, None]).all()):  # NaN is outside, too
        raise InputError("times: expected times between 0 and the end of each member")
    if (rows[:, 1:] < rows[:, :-1]).any():
        raise InputError("times must be sorted for each member")
    return read_only(rows)


def over_threads(
    shares: Sequence[Callable[[], None]], asked: Asked, progress: Callable[[float], None] | None
) -> None:
    """Run shares of the work on several threads, and report progress.

    Args:
        shares: Functions that each compute one share of the work.
        asked: The validated request.
        progress: Called with the finished fraction of the members, or None.
    """
    batch = asked.batch
    with _workers(asked.threads) as pool:
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
            batch.stop[0] = 1  # threads check this at their next pause
            for future in futures:
                future.cancel()
            wait(futures)
            raise


@contextmanager
def _workers(threads: int) -> Iterator[ThreadPoolExecutor]:
    """Yield a pool of threads; a single thread is kept for further calls of the same caller.

    The caller itself must not run the shares: Ctrl-C and progress reports would wait for their end.
    """
    if threads > 1:
        pool = ThreadPoolExecutor(threads)
        try:
            yield pool
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
        return
    # A forked process has a copy of the pool, but not its thread.
    kept: tuple[int, ThreadPoolExecutor] | None = getattr(_kept, "pool", None)
    if kept is None or kept[0] != os.getpid():
        _kept.pool = kept = os.getpid(), ThreadPoolExecutor(1)
    yield kept[1]


def solutions(method: Method, batch: Batch) -> Solutions:
    """Return the results of a finished batch."""
    names = ("status", "t", "entry", "steps", "rejected", "evaluations")
    outcomes = [batch.outcomes[name].copy() for name in names]
    times = batch.times[0] if len(batch.times) == 1 else batch.times
    return Solutions(method, times, batch.y, *outcomes)
