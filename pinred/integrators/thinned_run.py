"""Long runs of methods with equal steps, which store the states at report times only.

The registers and work rows of a run are copied a few times on the way. The states at other times
are integrated again from the last copy before them, with the same bits at step ends.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ..common.arrays import Array, read_only
from ..common.errors import IntegrationError
from .integrate import Canonical, Progress, Tangent, begun_by, failure, give_tangent
from .methods.method import EqualSteps
from .stepping.codes import DONE, UNDERFLOW, WANTED
from .stepping.run_state import Runs, copied
from .stepping.state_rows import Quaternions, Y

_MOST_COPIES = 64  # largest number of copies of the registers and work rows of a run
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
        self._stepper = method.stepper()
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
    ) -> ThinnedSolution:
        """Integrate from y0 (n,) at time 0.

        Args:
            params: Parameters of the kernel, (p,) read-only.
            y0: Initial state, (n,).
            times: Report times, (T,) sorted and read-only [s].
            progress: Called repeatedly with the finished fraction of the time.
            look: Called repeatedly with the times (2,) [s] of two step ends and the states (2, n).
        Returns:
            The solution.
        """
        run, work = copied(self._first), self._stepper.work(self._n)
        work[Y, : self._n] = y0
        size = run.nbytes + work.nbytes
        copies = [RunCopy(copied(run), work.copy())]
        most = max(1, min(_MOST_COPIES, _COPY_BYTES // size))
        before = np.array([0.0]), np.array([y0])

        def pause(run: Runs, work: Array) -> bool:
            nonlocal before
            here = run["t"].copy(), work[Y : Y + 1, : self._n].copy()
            if look is not None and run["steps"]:
                look(*(np.concatenate(pair) for pair in zip(before, here, strict=True)))
            before = here
            if here[0][0] < self._end and here[0][0] * most >= self._end * len(copies):
                copies.append(RunCopy(copied(run), work.copy()))
            if progress is not None:
                progress(here[0][0] / self._end)
            return False

        reported = np.empty((len(times), self._n))
        last = self._advance(run, work, params, times, reported, pause)
        return ThinnedSolution(times, read_only(reported), params, [*copies, last], self)

    def rerun(self, copy: RunCopy, params: Array, times: Array, out: Array) -> None:
        """Integrate again from a copy, and write the states at times (T,) to `out` (T, n)."""
        run = copied(copy.run)
        run["next"] = 0
        self._advance(
            run, copy.work.copy(), params, times, out, lambda run, _: run["next"][0] == len(times)
        )

    def _advance(
        self,
        run: Runs,
        work: Array,
        params: Array,
        times: Array,
        out: Array,
        pause: Callable[[Runs, Array], bool],
    ) -> RunCopy:
        """Integrate to the end, or until `pause`, called repeatedly, returns True."""
        while True:
            status = self._stepper.loops.advance(run, params, work, times, out, *self._no_knots)
            if status == WANTED:
                give_tangent(self._tangent, self._method, run)
                work = self._stepper.widened(self._n, work)
            elif status >= UNDERFLOW:
                raise self._failure(status, run, work)
            elif pause(run, work) or status == DONE:
                return RunCopy(run, work)

    def _failure(self, status: int, run: Runs, work: Array) -> IntegrationError:
        return failure(status, run, work[Y, : self._n].copy())
