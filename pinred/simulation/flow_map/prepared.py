"""Runs of one stretch, prepared: what does not change from call to call is there already."""

from __future__ import annotations

import numpy as np

from ...common.arrays import Array, read_only
from ...integrators.integrate import Canonical, Solution, begun_by
from ...integrators.methods import Method
from ...integrators.stepping.run_record import DONE, LAYOUT, PAUSED, Runs
from ...integrators.stepping.state_rows import Y

_KNOTS = 128  # at first


class Ran:
    """A run that came to its end, of which a Solution is made when one is asked for.

    y: (T, n) its states at the times.
    """

    def __init__(
        self, method: Method, times: Array, y: Array, params: Array, kept: tuple[Runs, Array, Array]
    ) -> None:
        """Take what the loop has left."""
        self._method, self._times, self.y, self._params, self._kept = method, times, y, params, kept
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
    def solution(self) -> Solution:
        """The run as `integrate` gives it."""
        if self._solution is None:
            run, knots, states = self._kept
            steps, n = run["steps"].item(), self.y.shape[1]
            stored = read_only(states[: steps + 1])
            self._solution = Solution(
                method=self._method,
                times=self._times,
                y=read_only(self.y),
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
    """A stretch of an explicit method from 0 to an end, for any initial state and parameters."""

    def __init__(
        self,
        method: Method,
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
        self._advance, self._kept = stepper.loops.advance, stepper.kept * n
        self._first = begun_by(method, address, n, end, quaternion, canonical, keep=1).tobytes()
        self._work, self._room = stepper.work(n), _KNOTS

    def __call__(self, params: Array, y0: Array) -> Ran | None:
        """Return a run; None of one that fails, or takes more steps than there is room for.

        params: (p,) read-only.  y0: (n,).
        """
        n, times, room = self._n, self._times, self._room
        run = np.frombuffer(bytearray(self._first), LAYOUT)
        work = self._work.copy()
        work[Y, :n] = y0
        out, knots, states = np.empty((len(times), n)), np.empty(room), np.empty((room, self._kept))
        status = PAUSED
        while status == PAUSED:
            status = self._advance(run, params, work, times, out, knots, states)
        if status != DONE:
            return None
        return Ran(self._method, times, out, params, (run, knots, states))

    def make_room(self, steps: int) -> None:
        """Have room for runs of about so many steps."""
        self._room = max(self._room, steps + steps // 2 + 2)
