"""Hairer's integrators as wrapped by SciPy, with exceptions, step lengths and dense output.

SciPy's compiled loop swallows exceptions of its callbacks, Ctrl-C included, and continues with
undefined values, possibly forever. So callbacks raise nothing here. An exception is stored, the
loop is asked to stop after its step, and the exception is raised afterwards.

The loop restarts at each end of a span. Its guess of the first step is about ten times too short,
which doubles the number of evaluations where spans are short. So the length of earlier accepted
steps is passed on as the first step. Times within a span need no restart: the stages of dop853 are
recorded for its dense output.
"""

from __future__ import annotations

import warnings
from bisect import bisect_right
from collections.abc import Callable, Sequence

import numpy as np

from ..common.arrays import Array
from ..common.interrupts import held_interrupt
from .hairer_dense_output import DenseOutput, Step, dense_output
from .scipy_files import ode

_CONTINUE, _STOP = 1, -1  # return values of the callback after each step
_MOST_STEPS = 10_000_000
_EVALUATIONS = {
    "dop853": 12,
    "dopri5": 6,
}  # number of evaluations of the vector field per accepted step
_CALM = 8  # number of consecutive spans without rejected steps before longer first steps are tried
# Hairer's error estimate squares changes, so changes below this in a run would give 0/0.
_LEAST = 1e-120
_SMALL = 1e-200  # square of the norm of a rate above which no change is that small in all entries


class Hairer:
    """An initial value problem dy/dt = rate(t, y) under "dop853" or "dopri5".

    Attributes:
        rtol: Relative tolerance.
    """

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
        """Set up the problem.

        Args:
            rate: Vector field (t, y) → dy/dt, (n,).
            method: "dop853" (order 8) or "dopri5" (order 5).
            y: Initial state, (n,).
            t: Initial time [s].
            rtol: Relative tolerance.
            atol: Absolute tolerance.
            end: Last requested time [s]. Rates too small to change y until then count as zero.
        """
        self._rate, self.rtol = rate, rtol
        self._least = _LEAST / max(end - t, 1.0)
        self._raised: BaseException | None = None
        self._is_interrupted: Callable[[], bool] = bool
        self._method, self._options = method, {"rtol": rtol, "atol": atol, "nsteps": _MOST_STEPS}
        self._solver = ode(self._safe_rate).set_integrator(method, **self._options)
        self._solver.set_initial_value(y, t)
        self._first_step, self._calm_spans = 0.0, 0  # step [s]; spans since the last rejection
        self._patience = (
            0  # spans before the first step is doubled; 0 until a doubled step is rejected
        )
        self._evaluations, self._step_ends = 0, [t]
        self._rates: list[Array] = []  # rates at the last step end and after it
        self._targets: list[float] = []
        self._passed = 0  # number of targets up to the last step end
        self._y, self._steps = y, list[Step]()

    @property
    def t(self) -> float:
        """Time reached [s]."""
        return float(self._solver.t)

    @property
    def step_ends(self) -> list[float]:
        """Ends of the steps of the last span [s]."""
        return self._step_ends[1:]

    def integrate(self, t: float, targets: Sequence[float] = ()) -> Array | None:
        """Integrate to time t, and re-raise exceptions of the vector field and KeyboardInterrupt.

        Args:
            t: Time [s].
            targets: Increasing times up to t at which the dense output will be evaluated [s].
        Returns:
            The state, (n,), or None if the time cannot be reached.
        """
        self._restart(targets)
        with held_interrupt() as self._is_interrupted, warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # the caller reports failures
            y = self._solver.integrate(t)
        if self._raised is not None:
            raise self._raised
        self._update_first_step()
        return y if self._solver.successful() and np.isfinite(y).all() else None

    def dense(self) -> DenseOutput | None:
        """Return the dense output of the steps of the last span that contain targets.

        Returns:
            The dense output, or None if no target lies within a step.
        """
        return dense_output(self._steps, self._rate) if self._steps else None

    def _restart(self, targets: Sequence[float]) -> None:
        """Set the first step to the length of accepted steps; 0 lets the loop guess it."""
        options = {**self._options, "first_step": self._first_step}
        self._solver.set_integrator(self._method, **options)
        self._solver.set_solout(self._after_step)
        self._evaluations, self._step_ends = 0, []
        self._targets = list(targets) if self._method == "dop853" else []
        self._rates, self._steps = [], []

    def _update_first_step(self) -> None:
        """Set the first step of the next span from the accepted steps of this span."""
        lengths = np.diff(self._step_ends)
        if not len(lengths):
            return
        # The loop evaluates once at its initial state, and a second time where it guesses a step.
        if self._evaluations > _EVALUATIONS[self._method] * len(lengths) + 2:
            self._first_step, self._calm_spans = float(lengths.max()), 0
            self._patience = _CALM
            return
        self._first_step = max(self._first_step, float(lengths.max()))
        self._calm_spans += 1
        if self._calm_spans > self._patience:
            self._first_step = 2.0 * min(self._first_step, float(lengths.sum()))
            self._calm_spans = 0

    def _safe_rate(self, t: float, y: Array) -> Array:
        """Return dy/dt, or zero after a stop request, so that the loop accepts its step."""
        if self._raised is not None or self._is_interrupted():
            return np.zeros(len(y))
        self._evaluations += 1
        try:
            rate = self._rate(t, y)
        except BaseException as error:  # any exception is raised again outside the loop
            self._raised = error
            return np.zeros(len(y))
        if rate.dot(rate) < _SMALL:
            rate = np.where(np.abs(rate) < self._least, 0.0, rate)
        if self._targets:
            self._rates.append(rate)
        return rate

    def _after_step(self, t: float, y: Array) -> int:
        if self._targets:
            self._record_step(t, y.copy())
        self._step_ends.append(t)
        return _STOP if self._raised is not None or self._is_interrupted() else _CONTINUE

    def _record_step(self, t: float, y: Array) -> None:
        """Store the step that ends at t if it contains a target, and drop its rates."""
        passed = bisect_right(self._targets, t)
        if not self._step_ends:  # the loop also reports its initial state
            del self._rates[1:]
        else:
            if passed > self._passed:
                rates = [self._rates[0], *self._rates[-_EVALUATIONS[self._method] :]]
                self._steps.append(Step(self._step_ends[-1], t, self._y, y, rates))
            del self._rates[:-1]
        self._passed, self._y = passed, y
