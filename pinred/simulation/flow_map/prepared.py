"""Runs of one stretch, prepared: what does not change from call to call is there already."""

from __future__ import annotations

import numpy as np

from ...common.arrays import Array, read_only
from ...integrators.integrate import Canonical, Solution, begun_by
from ...integrators.methods import Method
from ...integrators.methods.method import ErrorControl
from ...integrators.stepping.run_record import (
    DONE,
    ENDS_KEPT,
    LAYOUT,
    PAUSED,
    STAGES_KEPT,
    Runs,
)
from ...integrators.stepping.state_rows import Y

_KNOTS = 128  # at first
MOST_STAGES = 1 << 25  # bytes of a run whose stages are kept


class Ran:
    """A run that came to its end, of which a Solution is made when one is asked for.

    y: (T, n) its states at the times, read-only.
    """

    def __init__(
        self, method: Method, times: Array, y: Array, params: Array, kept: tuple[Runs, Array, Array]
    ) -> None:
        """Take what the loop has left."""
        self._method, self._times, self._params, self._kept = method, times, params, kept
        self.y = read_only(y)
        self._solution: Solution | None = None

    @property
    def knots(self) -> Array:
        """The times of the ends of all steps, (K,) [s]."""
        run, knots, _ = self._kept
        return read_only(knots[: run["steps"].item() + 1])

    @property
    def states(self) -> Array:
        """The states there, (K, n)."""
        run, _, states = self._kept
        return read_only(states[: run["steps"].item() + 1, : self.y.shape[1]])

    @property
    def stored(self) -> Array:
        """The same with what is kept of the stages that led there, (K, n + …)."""
        run, _, states = self._kept
        return read_only(states[: run["steps"].item() + 1])

    @property
    def solution(self) -> Solution:
        """The run as `integrate` gives it."""
        if self._solution is None:
            run, knots, states = self._kept
            steps, n = run["steps"].item(), self.y.shape[1]
            stored = read_only(states[: steps + 1])
            self._solution = Solution(
                method=self._method,
                times=self._times,
                y=self.y,
                steps=steps,
                rejected=run["rejected"].item(),
                evaluations=run["evaluations"].item(),
                knots=read_only(knots[: steps + 1]),
                states=stored[:, :n],
                complete=True,
                _stored=stored,
                _params=self._params,
                _run=run,
            )
        return self._solution


class Prepared:
    """A stretch from 0 to an end by steps of their own lengths, for any begin and parameters.

    Where it is asked for, it keeps the rates of stages for the way back, as long as they take no
    more than MOST_STAGES bytes.
    """

    def __init__(
        self,
        method: ErrorControl,
        address: int,
        n: int,
        end: float,
        times: Array,
        quaternion: int,
        canonical: Canonical,
    ) -> None:
        """Take what all runs have in common; times: (T,) read-only."""
        self._method, self._times, self._n = method, times, n
        stepper = method.stepper()
        self._advance = stepper.loops.advance
        self._kept = [stepper.kept * n, (stepper.kept + stepper.stages) * n]
        self._first = [
            begun_by(method, address, n, end, quaternion, canonical, keep).tobytes()
            for keep in (ENDS_KEPT, STAGES_KEPT)
        ]
        self._work, self._room = stepper.work(n), _KNOTS

    def __call__(self, params: Array, y0: Array, *, stages: bool) -> Ran | None:
        """Return a run; None of one that fails, or takes more steps than there is room for.

        params: (p,) read-only.  y0: (n,).  stages: whether those are to be kept.
        """
        n, times, room = self._n, self._times, self._room
        which = stages and 8 * room * self._kept[1] <= MOST_STAGES
        run = np.frombuffer(bytearray(self._first[which]), LAYOUT)
        work = self._work.copy()
        work[Y, :n] = y0
        out, knots = np.empty((len(times), n)), np.empty(room)
        states = np.empty((room, self._kept[which]))
        status = PAUSED
        while status == PAUSED:
            status = self._advance(run, params, work, times, out, knots, states)
        if status != DONE:
            return None
        return Ran(self._method, times, out, params, (run, knots, states))

    def make_room(self, steps: int) -> None:
        """Have room for runs of about so many steps."""
        self._room = max(self._room, steps + steps // 2 + 2)
