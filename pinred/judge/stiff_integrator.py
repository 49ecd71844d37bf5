"""Radau IIA of order 13 with control of steps, for scenes that are stiff for explicit methods.

A step solves y(t) = y(a) + ∫ f(s, y(s)) ds at seven nodes, the last of which is the step end. The
simplified Newton iteration uses one Jacobian of ABA per step. Its seven linear systems are
decoupled by the eigenvectors of the inverse Runge–Kutta matrix. The method is L-stable, so parts
that decay within a step do not limit its length.
Source: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 2nd ed., section IV.8.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import legendre

from ..common.arrays import Array
from .time_budget import Rate

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
            rest = t - self.t
            h = rest if self._h > 0.999 * rest else min(self._h, 0.5 * rest)
            reached = t if h == rest else self.t + h
            too_short = h < rest and h < _SHORTEST * max(self._duration, self.t)
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
