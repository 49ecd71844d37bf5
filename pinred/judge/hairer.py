"""Hairer's integrators through SciPy, out of which everything comes that is raised within them.

SciPy's compiled loop swallows what its callbacks raise, Ctrl-C included, and goes on with what
happens to be in its memory, perhaps for ever.  So nothing is raised there: a failure is kept, the
loop is told to stop after its step, and the failure is raised behind it.

That loop begins anew at each time that is asked for, and its own guess of a first step is some ten
times too short, which doubles the evaluations where times are close.  So it is told what has
passed before.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
from scipy.integrate import ode

from ..common.arrays import Array
from ..common.interrupts import held_interrupt

_GO, _STOP = 1, -1  # what the loop is told after a step
_MOST_STEPS = 10_000_000
_EVALUATIONS = {"dop853": 12, "dopri5": 6}  # of a step that passes
_CALM = 8  # spans without a rejected step, after which longer steps are tried
_LEAST = 1e-120  # change over a run; of the squares of less, Hairer's error estimate makes 0/0


class Hairer:
    """An initial value problem under "dop853" or "dopri5".  t: the time reached [s]."""

    def __init__(
        self,
        rate: Callable[[float, Array], Array],
        method: str,
        y: Array,
        t: float,
        rtol: float,
        atol: float,
        end: float,
    ) -> None:
        """Take the vector field dy/dt = rate(t, y), and y (n,) at the time t.

        end: the last time that is asked for; rates that move nothing until then are none.
        """
        self._rate = rate
        self._least = _LEAST / max(end - t, 1.0)
        self._raised: BaseException | None = None
        self._stopped: Callable[[], bool] = bool
        self._method, self._options = method, {"rtol": rtol, "atol": atol, "nsteps": _MOST_STEPS}
        self._solver = ode(self._kept).set_integrator(method, **self._options)
        self._solver.set_initial_value(y, t)
        self._passed, self._calm = 0.0, 0  # the length of steps that pass, and for how many spans
        self._patience = 0  # spans after which longer ones are tried: at once, until that fails
        self._evaluations, self._ends = 0, [t]

    @property
    def t(self) -> float:
        """The time reached [s]."""
        return float(self._solver.t)

    def integrate(self, t: float) -> Array | None:
        """Return y (n,) at a time, or None if it cannot be reached.

        Raises what the vector field raises, and KeyboardInterrupt.
        """
        self._begin()
        with held_interrupt() as self._stopped, warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # its failures are the caller's to tell
            y = self._solver.integrate(t)
        if self._raised is not None:
            raise self._raised
        self._learn()
        return y if self._solver.successful() and np.isfinite(y).all() else None

    def _begin(self) -> None:
        """Begin with a step as long as those that pass; at first, as the loop guesses it (0)."""
        options = {**self._options, "first_step": self._passed}
        self._solver.set_integrator(self._method, **options)
        self._solver.set_solout(self._after_a_step)
        self._evaluations, self._ends = 0, []

    def _learn(self) -> None:
        """Take note of how long steps may be."""
        lengths = np.diff(self._ends)
        if not len(lengths):
            return
        # One evaluation at the begin, and a second where the loop guesses.
        if self._evaluations > _EVALUATIONS[self._method] * len(lengths) + 2:
            self._passed, self._calm, self._patience = float(lengths.max()), 0, _CALM
            return
        self._passed, self._calm = max(self._passed, float(lengths.max())), self._calm + 1
        if self._calm > self._patience:
            self._passed, self._calm = 2.0 * min(self._passed, float(lengths.sum())), 0

    def _kept(self, t: float, y: Array) -> Array:
        """Return dy/dt; zero, with which any step succeeds, once the run is to stop."""
        rate = np.zeros_like(y)
        if self._raised is None and not self._stopped():
            self._evaluations += 1
            try:
                rate = self._rate(t, y)
            except BaseException as error:  # whatever it is, it is raised again outside
                self._raised = error
        return np.where(np.abs(rate) < self._least, 0.0, rate)

    def _after_a_step(self, t: float, _y: Array) -> int:
        self._ends.append(t)
        return _STOP if self._raised is not None or self._stopped() else _GO
