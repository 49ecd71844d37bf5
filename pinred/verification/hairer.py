"""Hairer's integrators through SciPy, out of which everything comes that is raised within them.

SciPy's compiled loop swallows what its callbacks raise, Ctrl-C included, and goes on with what
happens to be in its memory, perhaps for ever.  So nothing is raised there: a failure is kept, the
loop is told to stop after its step, and the failure is raised behind it.
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
        solver = ode(self._kept)
        solver.set_integrator(method, rtol=rtol, atol=atol, nsteps=_MOST_STEPS)
        solver.set_solout(self._after_a_step)
        self._solver = solver.set_initial_value(y, t)

    @property
    def t(self) -> float:
        """The time reached [s]."""
        return float(self._solver.t)

    def integrate(self, t: float) -> Array | None:
        """Return y (n,) at a time, or None if it cannot be reached.

        Raises what the vector field raises, and KeyboardInterrupt.
        """
        with held_interrupt() as self._stopped, warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # its failures are the caller's to tell
            y = self._solver.integrate(t)
        if self._raised is not None:
            raise self._raised
        return y if self._solver.successful() and np.isfinite(y).all() else None

    def _kept(self, t: float, y: Array) -> Array:
        """Return dy/dt; zero, with which any step succeeds, once the run is to stop."""
        if self._raised is not None or self._stopped():
            return np.zeros_like(y)
        try:
            rate = self._rate(t, y)
            return np.where(np.abs(rate) < self._least, 0.0, rate)
        except BaseException as error:  # whatever it is, it is raised again outside
            self._raised = error
            return np.zeros_like(y)

    def _after_a_step(self, _t: float, _y: Array) -> int:
        return _STOP if self._raised is not None or self._stopped() else _GO
