"""Long runs of methods with equal steps, which store the states at report times only.

The registers and work rows of a run are copied a few times on the way. The states at other times
are integrated again from the last copy before them, with the same bits at step ends.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..common.arrays import Array, read_only
from ..common.errors import IntegrationError
from .integrate import (
    Progress,
    RunKeeper,
    SavedRun,
    Tangent,
    begun_by,
    failure,
    give_tangent,
    packed_registers,
    unpacked_registers,
)
from .methods.method import EqualSteps, stepper_of
from .stepping.run_state import DONE, UNDERFLOW, WANTED, Canonical, Quaternions, Runs, Y, copied

MOST_COPIES = 64  # largest number of copies of the registers and work rows of a run
_COPY_BYTES = 1 << 22  # largest size of these copies [bytes], unless two are larger

Look = Callable[[Array, Array], None]


@dataclass(frozen=True)
class RunCopy:
    """The registers and work rows of a run between two steps.

    Attributes:
        run: Registers, (1,).
        work: Work rows.
    """

    run: Runs
    work: Array

    @property
    def time(self) -> float:
        """Time [s]."""
        return float(self.run["t"].item())

    @property
    def steps(self) -> int:
        """Number of steps before this time."""
        return int(self.run["steps"].item())

    @property
    def evaluations(self) -> int:
        """Number of evaluations of the vector field before this time."""
        return int(self.run["evaluations"].item())


@dataclass(frozen=True, eq=False)
class ThinnedSolution:
    """Solution of a run without its step ends.

    Attributes:
        times: Report times, (T,) sorted [s].
        y: States at the report times, (T, n).
        params: Parameters of the kernel, (p,).
        copies: Copies of the run in order of time, from the start to the end.
    """

    times: Array
    y: Array
    params: Array
    copies: list[RunCopy]
    _integration: ThinnedIntegration = field(repr=False)

    def at(self, k: int, times: Array) -> Array:
        """Integrate again from copy k.

        Args:
            k: Index of a copy.
            times: Times between copies k and k + 1, (T,) in any order [s].
        Returns:
            States, (T, n).
        """
        order = np.argsort(times, kind="stable")
        sorted_states = np.empty((len(times), self.y.shape[1]))
        self._integration.rerun(self.copies[k], self.params, read_only(times[order]), sorted_states)
        y = np.empty_like(sorted_states)
        y[order] = sorted_states
        return y

    def anywhere(self, times: Array) -> Array:
        """Return the states (T, n) at times (T,) of the run [s], integrated again from copies."""
        starts = np.array([copy.time for copy in self.copies[1:-1]])
        which = np.searchsorted(starts, times, side="right")
        y = np.empty((len(times), self.y.shape[1]))
        for k in np.unique(which):
            y[which == k] = self.at(k, times[which == k])
        return y

    def step_ends(self, k: int) -> Array:
        """Return the step ends between copies k and k + 1, both included, (K,) [s]."""
        first, last = self.copies[k], self.copies[k + 1]
        ends: Array = np.arange(first.steps, last.steps + 1) * first.run["h"]
        ends[0], ends[-1] = first.time, last.time
        return ends


class ThinnedIntegration:
    """A prepared integration with equal steps over one span of time."""

    def __init__(
        self,
        method: EqualSteps,
        address: int,
        n: int,
        end: float,
        quaternions: Quaternions,
        canonical: Canonical,
        tangent: Tangent | None,
    ) -> None:
        """Prepare the data of the run; arguments are not validated.

        Args:
            method: Method with equal steps.
            address: Address of the kernel.
            n: Number of entries of the state.
            end: End time [s].
            quaternions: As for `integrate`.
            canonical: As for `integrate`.
            tangent: As for `integrate`.
        """
        self._method, self._n, self._end, self._tangent = method, n, end, tangent
        self._stepper = stepper_of(method)
        self._first = begun_by(method, address, n, end, quaternions, canonical)
        if self._stepper.needs_tangent:
            give_tangent(tangent, method, self._first)
        self._no_knots = np.empty(0), np.empty((0, n))

    def __call__(
        self,
        params: Array,
        y0: Array,
        times: Array,
        progress: Progress | None = None,
        look: Look | None = None,
        keeper: RunKeeper | None = None,
        watch: Callable[[ThinnedSolution], bool] | None = None,
        most_copies: int = MOST_COPIES,
    ) -> ThinnedSolution:
        """Integrate from y0 (n,) at time 0.

        Args:
            params: Parameters of the kernel, (p,) read-only.
            y0: Initial state, (n,).
            times: Report times, (T,) sorted and read-only [s].
            progress: Called repeatedly with the finished fraction of the time.
            look: Called repeatedly with the times (2,) [s] of two step ends and the states (2, n).
            keeper: Saves the run at its pauses, and continues a saved run.
            watch: Called with the solution since its last call, repeatedly and before a failure;
                if it returns True, the integration stops.
            most_copies: Largest number of copies.
        Returns:
            The solution; its report times are those that the run has reached.
        Raises:
            IntegrationError: The integration failed.
        """
        n = self._n
        run, work = copied(self._first), self._stepper.work(n)
        work[Y, :n] = y0
        reported, copies = np.empty((len(times), n)), [RunCopy(copied(run), work.copy())]
        before = np.array([0.0]), np.array([y0])
        saved = None if keeper is None else keeper.saved()
        if saved is not None:
            end = self._restored(saved["end"])
            run, work = end.run, end.work
            reported, copies = saved["reported"], [self._restored(c) for c in saved["copies"]]
            before = saved["before"]
        most = max(1, min(most_copies, _COPY_BYTES // (run.nbytes + work.nbytes)))

        def state() -> dict[str, Any]:
            return {
                "end": _packed(RunCopy(run, work)),
                "copies": [_packed(copy) for copy in copies],
                "reported": reported,
                "before": list(before),
            }

        while True:
            if keeper is not None:
                keeper.pause(state)
            start = RunCopy(copied(run), work.copy()) if watch is not None else None
            failed = None
            try:
                done, work = self._advance(run, params, work, times, reported)
            except IntegrationError as error:
                done, failed = True, error
            if watch is not None and start is not None and run["steps"].item() > start.steps:
                window = [start, RunCopy(copied(run), work)]
                if watch(ThinnedSolution(times[:0], reported[:0], params, window, self)):
                    failed, done = None, True
            if failed is not None:
                raise failed
            here = run["t"].copy(), work[Y : Y + 1, :n].copy()
            if look is not None:
                look(*(np.concatenate(pair) for pair in zip(before, here, strict=True)))
            before, time = here, float(here[0][0])
            if progress is not None:
                progress(time / self._end)
            if done:
                break
            if time * most >= self._end * len(copies):
                copies.append(RunCopy(copied(run), work.copy()))
        if keeper is not None:
            keeper.finish(state())
        parts = [*copies, RunCopy(run, work)]
        count = run["next"].item()
        return ThinnedSolution(times[:count], read_only(reported[:count]), params, parts, self)

    def rerun(self, copy: RunCopy, params: Array, times: Array, out: Array) -> None:
        """Integrate again from a copy, and write the states at times (T,) to `out` (T, n)."""
        run, work, done = copied(copy.run), copy.work.copy(), False
        run["next"] = 0
        while not done and run["next"].item() < len(times):
            try:
                done, work = self._advance(run, params, work, times, out)
            except IntegrationError:  # after the last of the times, as in the first run
                if run["next"].item() < len(times):
                    raise

    def _advance(
        self, run: Runs, params: Array, work: Array, times: Array, out: Array
    ) -> tuple[bool, Array]:
        """Integrate to the next pause; return whether the run is finished, and its work rows."""
        status = self._stepper.loops.advance(run, params, work, times, out, *self._no_knots)
        if status == WANTED:
            give_tangent(self._tangent, self._method, run)
            return False, self._stepper.widened(self._n, work)
        if status >= UNDERFLOW:
            raise failure(status, run, work[Y, : self._n].copy())
        return status == DONE, work

    def _restored(self, saved: SavedRun) -> RunCopy:
        """Return a saved copy of this run."""
        run = unpacked_registers(saved["run"], self._first)
        if run["tangent"]:
            give_tangent(self._tangent, self._method, run)
        return RunCopy(run, saved["work"])


def _packed(copy: RunCopy) -> dict[str, Any]:
    return {"run": packed_registers(copy.run), "work": copy.work}
