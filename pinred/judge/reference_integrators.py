"""Integrators of the reference solution, and the time limit of a comparison.

The limit counts processor time, so a verdict does not depend on other programs of the machine.

Parts of SciPy are loaded from their files alone: `ode`, coefficients of DOP853, LAPACK's dposv.
Importing their packages, scipy.integrate and scipy.linalg, takes longer than most comparisons.

Hairer's codes are used as SciPy wraps them. SciPy's compiled loop swallows exceptions of its
callbacks, Ctrl-C included, and continues with undefined values, possibly forever. So callbacks
raise nothing here. An exception is stored, the loop is asked to stop after its step, and the
exception is raised afterwards.

The loop restarts at each end of a span. Its guess of the first step is about ten times too short,
which doubles the number of evaluations where spans are short. So the length of earlier accepted
steps is passed on as the first step. Times within a span need no restart: the stages of dop853 are
recorded, and its dense output, a polynomial of order 7 in each step, is formed from them and from
three further evaluations, with the coefficients of SciPy's `DOP853`.
Source: E. Hairer, S. P. Nørsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd ed.,
section II.6.

Radau IIA of order 13 with control of steps serves scenes that are stiff for explicit methods. A
step solves y(t) = y(a) + ∫ f(s, y(s)) ds at seven nodes, the last of which is the step end. The
simplified Newton iteration uses one Jacobian of ABA per step. Its seven linear systems are
decoupled by the eigenvectors of the inverse Runge–Kutta matrix. The method is L-stable, so parts
that decay within a step do not limit its length.
Source: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 2nd ed., section IV.8.
"""

from __future__ import annotations

import sys
import warnings
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from runpy import run_path
from time import perf_counter, thread_time
from types import ModuleType
from typing import Any

import numpy as np
import scipy
from numpy.polynomial import legendre

from ..common.arrays import Array
from ..common.errors import IntegrationError
from ..common.waiting import held_interrupt

Rate = Callable[[float, Array], Array]

LEAST = 30.0  # default time limit of short motions [s]
RATIO = 500.0  # default time limit relative to the wall time of the simulation


def default_budget(wall: float) -> float:
    """Return the time limit [s] of a comparison with a simulation that took `wall` [s]."""
    return max(LEAST, RATIO * wall)


class AbaStopped(IntegrationError):  # noqa: N818
    """ABA did not reach the end of the motion.

    Attributes:
        time: Last time of the motion that ABA reached [s].
    """

    def __init__(self, message: str, time: float) -> None:
        """Store the message and the time that ABA reached [s]."""
        super().__init__(f"{message}; it reached t = {time:.6g} s")
        self.time = time


class TimeBudget:
    """A time limit that starts when it is created.

    Attributes:
        seconds: Time limit, in processor time of the current thread [s].
    """

    def __init__(
        self,
        seconds: float,
        clock: Callable[[], float] = thread_time,
        wall: Callable[[], float] = perf_counter,
    ) -> None:
        """Start the clock.

        Args:
            seconds: Time limit [s].
            clock: Function that returns the processor time [s].
            wall: Function that returns the wall time [s], which advances at least as fast.
        """
        self.seconds, self._clock, self._wall = seconds, clock, wall
        self._start, self._due = clock(), wall() + seconds

    def is_exceeded(self) -> bool:
        """Return whether the time is up.  The processor time is read only if it can be."""
        now = self._wall()
        if now <= self._due:
            return False
        remaining = self.seconds - (self._clock() - self._start)
        self._due = now + remaining
        return remaining < 0.0

    def limit(self, rate: Rate) -> Rate:
        """Return a vector field that raises AbaStopped when the time is up."""

        def limited(t: float, y: Array) -> Array:
            if self.is_exceeded():
                raise AbaStopped(f"ABA exceeded {self.seconds:g} s of processor time", t)
            return rate(t, y)

        return limited


_FOLDER = Path(scipy.__file__).parent


def _load(file: str, name: str, public: str) -> Any:
    """Return an object from its file, or from its package if other versions of SciPy need that.

    Args:
        file: The file's module inside SciPy, such as "integrate._ode".
        name: Name of the object.
        public: Module of SciPy that documents the object.
    Returns:
        The object.
    """
    folder, module = file.split(".")
    package = ModuleType(f"{__name__}_{folder}")  # stands in for the package of the file
    package.__path__ = [str(_FOLDER / folder)]
    sys.modules[package.__name__] = package
    try:
        return getattr(import_module(f"{package.__name__}.{module}"), name)
    except (ImportError, AttributeError):
        return getattr(import_module(public), name)


ode = _load("integrate._ode", "ode", "scipy.integrate")
dposv = _load("linalg._flapack", "dposv", "scipy.linalg.lapack")
# Coefficients of the dense output: A and C of the additional stages, and D.
_coefficients = run_path(str(_FOLDER / "integrate" / "_ivp" / "dop853_coefficients.py"))
_first = _coefficients["N_STAGES"] + 1
A_EXTRA, C_EXTRA = _coefficients["A"][_first:], _coefficients["C"][_first:]
D = _coefficients["D"]


_STAGES = 13  # the 12 stages of a step, and the rate at its end
_POWERS = 7  # number of coefficients of the polynomial, besides the initial value


@dataclass(frozen=True)
class Step:
    """An accepted step of dop853.

    Attributes:
        t: Start [s].
        end: End [s].
        y: State at the start, (n,).
        y_end: State at the end, (n,).
        rates: Rates at the 12 stages and at the end, (n,) each.
    """

    t: float
    end: float
    y: Array
    y_end: Array
    rates: Sequence[Array]


@dataclass(frozen=True)
class DenseOutput:
    """States within S steps, which need not be adjacent.

    Attributes:
        starts: Starts of the steps, (S,) [s].
        ends: Ends of the steps, (S,) [s].
        y: States at the starts, (S, n).
        coefficients: Coefficients of the polynomials, (7, S, n).
    """

    starts: Array
    ends: Array
    y: Array
    coefficients: Array

    @staticmethod
    def joined(spans: Sequence[DenseOutput]) -> DenseOutput:
        """Return the dense output of several consecutive spans."""
        return DenseOutput(
            starts=np.concatenate([span.starts for span in spans]),
            ends=np.concatenate([span.ends for span in spans]),
            y=np.concatenate([span.y for span in spans]),
            coefficients=np.concatenate([span.coefficients for span in spans], axis=1),
        )

    def __call__(self, t: Array) -> Array:
        """Return the states (T, n) at times (T,), each of which lies within a step."""
        k = np.minimum(np.searchsorted(self.ends, t), len(self.ends) - 1)
        s = ((t - self.starts[k]) / (self.ends[k] - self.starts[k]))[:, None]
        y = np.zeros((len(t), self.y.shape[1]))
        for power in range(_POWERS - 1, -1, -1):
            y = (y + self.coefficients[power, k]) * (1.0 - s if power % 2 else s)
        return np.asarray(self.y[k] + y)


def dense_output(steps: Sequence[Step], rate: Callable[[float, Array], Array]) -> DenseOutput:
    """Form the dense output of steps.

    Args:
        steps: Accepted steps, S of them.
        rate: Vector field (t, y) → dy/dt, (n,), which is evaluated three times in each step.
    Returns:
        The dense output.
    """
    starts, ends = np.array([step.t for step in steps]), np.array([step.end for step in steps])
    y, y_end = np.array([step.y for step in steps]), np.array([step.y_end for step in steps])
    h, further = (ends - starts)[:, None], len(C_EXTRA)
    K = np.empty((_STAGES + further, *y.shape))
    K[:_STAGES] = np.array([step.rates for step in steps]).transpose(1, 0, 2)
    for stage, (a, c) in enumerate(zip(A_EXTRA, C_EXTRA, strict=True), _STAGES):
        states = y + h * np.tensordot(a[:stage], K[:stage], 1)
        times = starts + c * h[:, 0]
        K[stage] = [rate(t, state) for t, state in zip(times.tolist(), states, strict=True)]
    change, first = y_end - y, h * K[0]
    coefficients = np.empty((_POWERS, *y.shape))
    coefficients[0] = change
    coefficients[1] = first - change
    coefficients[2] = 2.0 * change - first - h * K[_STAGES - 1]
    coefficients[3:] = h * np.tensordot(D, K, 1)
    return DenseOutput(starts, ends, y, coefficients)


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


STAGES = 7
SLOPE_STEP = 1e-7  # step of the difference quotients of the Jacobian, relative to the units
_MOST_ITERATIONS = 12
_SLOW = 0.5  # ratio of consecutive Newton corrections above which they do not converge
_EPS = 2.3e-16  # relative perturbation of a state that shows the round-off of its rate
_NOISE = 100.0  # assumed ratio of the round-off of a step to the effect of this perturbation
_CONVERGED = 1e-2  # error of the Newton iteration, relative to the local tolerance
_INTERPOLATED = 0.03  # largest magnitude of the integral of P₆ over a part of the step
_FIRST, _SHORTEST = 1e-7, 1e-14  # first and shortest step, relative to the duration
_LONGER, _SHORTER, _MARGIN = 5.0, 0.1, 0.8  # limits and margin of the ratio of step lengths


def _nodes() -> Array:
    """Return the Radau nodes in (0, 1]: zeros of P₇ − P₆."""
    zeros = legendre.legroots([*(STAGES - 1) * [0.0], -1.0, 1.0])
    nodes = 0.5 * (np.sort(zeros.real) + 1.0)
    nodes[-1] = 1.0
    return np.asarray(nodes)


def _integrals(s: Array) -> Array:
    """Return ∫ P_k(2σ − 1) dσ from 0 to s for k < STAGES, (len(s), STAGES)."""
    P = legendre.legvander(2.0 * s - 1.0, STAGES)
    integrals = [s, *(0.5 * (P[:, k + 1] - P[:, k - 1]) / (2 * k + 1) for k in range(1, STAGES))]
    return np.column_stack(integrals)


NODES = _nodes()
# Legendre coefficients of the rate from its values at the nodes.
_COEFFICIENTS = np.linalg.inv(legendre.legvander(2.0 * NODES - 1.0, STAGES - 1))
_A_INVERSE = np.linalg.inv(_integrals(NODES) @ _COEFFICIENTS)
_GAMMA, _T = np.linalg.eig(_A_INVERSE)
_HALF = np.flatnonzero(_GAMMA.imag >= 0.0)  # the others are complex conjugates of these
_REAL = int(np.argmin(np.abs(_GAMMA[_HALF].imag)))
_GAMMA, _T, _T_INVERSE = _GAMMA[_HALF], _T[:, _HALF], np.linalg.inv(_T)[_HALF]
# Conjugate pairs contribute twice the real part of one of them.
_T = _T * np.where(np.arange(len(_HALF)) == _REAL, 1.0, 2.0)


def jacobian(rate: Rate, t: float, y: Array, units: Array) -> Array:
    """Return the Jacobian (n, n) of a vector field by difference quotients.

    Args:
        rate: Vector field (t, y) → dy/dt, (n,).
        t: Time [s].
        y: State, (n,).
        units: Units of the numbers in the state, (n,).
    """
    f, moves = rate(t, y), SLOPE_STEP * units
    return np.array([rate(t, y + move) - f for move in np.diag(moves)]).T / moves


def spectral_radius(J: Array) -> float:
    """Return the largest magnitude of an eigenvalue of a matrix; infinite if it is not finite."""
    return float(np.abs(np.linalg.eigvals(J)).max()) if np.isfinite(J).all() else np.inf


class StiffIntegrator:
    """An initial value problem dy/dt = rate(t, y).

    Attributes:
        rtol: Local tolerance, relative to the units.
        t: Time reached [s].
        step_ends: Ends of the steps of the last span [s].
        errors: Estimated errors of these steps, relative to the units.
        lasting: The parts of these errors that do not decay within a step.
        most_evaluations: Number of evaluations after which the integration is given up.
    """

    def __init__(
        self,
        rate: Rate,
        y: Array,
        t: float,
        tolerance: float,
        units: Array,
        end: float,
        *,
        first_step: float | None = None,
    ) -> None:
        """Set up the problem.

        Args:
            rate: Vector field (t, y) → dy/dt, (n,).
            y: Initial state, (n,).
            t: Initial time [s].
            tolerance: Local tolerance, relative to the units.
            units: Units of the numbers in a state, (n,).
            end: Last requested time [s].
            first_step: Length of the first step [s]; None for a small fraction of the duration.
        """
        self._rate, self._y, self.t, self.rtol, self._units = rate, y, t, tolerance, units
        self._duration = end - t
        self._h = _FIRST * self._duration if first_step is None else first_step
        self._stages: Array | None = None  # Legendre coefficients of the rate in the last step
        self._last = self._h
        self.most_evaluations, self._evaluations = 2**62, 0
        self.step_ends: list[float] = []
        self.errors: list[float] = []
        self.lasting: list[float] = []

    def integrate(self, t: float, times: Array) -> tuple[Array | None, Array]:
        """Integrate to time t.

        Args:
            t: Time [s].
            times: Increasing times up to t, (T,) [s].
        Returns:
            The state, (n,), or None if the time cannot be reached, and the states at `times`.
        """
        self.step_ends, self.errors, self.lasting = [], [], []
        states, k, self._stages = np.empty((len(times), len(self._y))), 0, None
        while self.t < t:
            remaining = t - self.t
            h = remaining if self._h > 0.999 * remaining else min(self._h, 0.5 * remaining)
            reached = t if h == remaining else self.t + h
            too_short = h < remaining and h < _SHORTEST * max(self._duration, self.t)
            if too_short or self._evaluations > self.most_evaluations:
                return None, states
            step = self._step(h)
            if step is None:
                continue
            y, coefficients = step
            last = k + int(np.searchsorted(times[k:], reached, side="right"))
            s = (times[k:last] - self.t) / h
            states[k:last] = self._y + h * (_integrals(s) @ coefficients)
            k, self._stages, self._last = last, coefficients, h
            self._y, self.t = y, reached
            self.step_ends.append(reached)
        return self._y, states

    def _step(self, h: float) -> tuple[Array, Array] | None:
        """Return the state after a step and the Legendre coefficients of its rate.

        Returns None if the step is rejected. In both cases the length of the next step is set.
        """
        t, y, n = self.t, self._y, len(self._y)
        with np.errstate(all="ignore"):
            rate = self._rate(t, y)
            self._evaluations += n + 3
            J = jacobian(self._rate, t, y, self._units)
            shifted = (_GAMMA / h)[:, None, None] * np.eye(n) - J
            if not np.isfinite(shifted).all():
                self._h = _SHORTER * h
                return None
            inverse = np.linalg.inv(shifted)
            Z = np.zeros((STAGES, n))
            if self._stages is not None:  # extrapolate the last step
                s = 1.0 + NODES * h / self._last
                Z = self._last * (_integrals(np.append(1.0, s)) @ self._stages)
                Z = Z[1:] - Z[0]
            blurred = self._rate(t, y + _EPS * (-1.0) ** np.arange(n) * self._units) - rate
            floor = _NOISE * np.abs(inverse[_REAL].real @ blurred / self._units)
            floors = np.maximum(floor, self.rtol)  # round-off does not decrease with the step
            before, ratio = np.inf, 0.1
            for iteration in range(_MOST_ITERATIONS):
                F = np.array([self._rate(t + c * h, y + z) for c, z in zip(NODES, Z, strict=True)])
                self._evaluations += STAGES
                W = _T_INVERSE @ F - (_GAMMA / h)[:, None] * (_T_INVERSE @ Z)
                correction = (_T @ np.einsum("kij,kj->ki", inverse, W)).real
                noise = float(np.abs(correction / self._units).max())
                Z += correction
                ratio = max(ratio if before == np.inf else noise / before, 1e-3)
                converged = noise * ratio < _CONVERGED * self.rtol
                if converged or not noise < np.inf or (ratio > _SLOW and iteration > 2):
                    break
                before = noise
            # Corrections that no longer decrease can be round-off.
            if not (converged or (np.abs(correction) < floors * self._units).all()):
                self._h = 0.3 * h
                return None
            # Rates of the collocation polynomial, which are smoother than those of ABA at Z.
            coefficients = _COEFFICIENTS @ (_A_INVERSE @ Z) / h
            filtered = _GAMMA[_REAL].real * (inverse[_REAL].real @ coefficients[-1])
            # In stiff directions, the filter also removes errors of the interpolation.
            within = _INTERPOLATED * h * coefficients[-1]
            errors = np.maximum(np.abs(filtered), np.abs(within)) / self._units
            error, scaled = float(errors.max()), max(float((errors / floors).max()), 1e-12)
            self._h = h * min(_LONGER, max(_SHORTER, _MARGIN * scaled ** (-1.0 / (STAGES + 1))))
            if not scaled <= 1.0:
                return None
            again = _GAMMA[_REAL].real / h * (inverse[_REAL].real @ (filtered + correction[-1]))
        self.errors.append(error + noise)
        self.lasting.append(float(np.abs(again / self._units).max()))
        return y + Z[-1], coefficients
