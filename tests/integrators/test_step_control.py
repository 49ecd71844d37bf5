"""Step control: independent of units, with the longest steps that the error allows."""

from __future__ import annotations

from math import factorial
from typing import Any

import numpy as np
import pytest
import scipy.integrate
from numpy.polynomial import Polynomial
from scipy.special import spherical_jn
from stiff_kernels import kernel, kernels

from pinred import DOP853, AdaptiveGauss, Tsit5
from pinred.integrators.integrate import Solution, integrate
from pinred.integrators.methods import METHODS, ErrorControl, Explicit

KINDS = [kind for kind in METHODS.values() if issubclass(kind, ErrorControl)]


def _wide(lanes: int) -> tuple[int, Any]:
    """Compile two oscillators with angular velocities p[0] and p[1] and friction p[2]."""

    def rate(y: Any, p: Any, d: Any) -> None:
        for j in range(lanes):
            a, b, u, v = y[j], y[lanes + j], y[2 * lanes + j], y[3 * lanes + j]
            d[j], d[lanes + j] = p[0] * b, -p[0] * a
            d[2 * lanes + j], d[3 * lanes + j] = p[1] * v, -p[1] * u - p[2] * v

    def slope(y: Any, p: Any, v: Any, d: Any) -> None:  # noqa: ARG001
        for j in range(8):
            d[j], d[8 + j] = p[0] * v[8 + j], -p[0] * v[j]
            d[16 + j], d[24 + j] = p[1] * v[24 + j], -p[1] * v[16 + j] - p[2] * v[24 + j]

    return kernels(rate, slope)


def _power(y: Any, p: Any, d: Any) -> None:
    d[0] = p[0] * y[0] ** p[1]


def _in_units(y: Any, p: Any, d: Any) -> None:
    for j in range(8):
        d[j], d[8 + j] = p[0] * y[8 + j], -y[j] / p[0]


KERNELS = {lanes: _wide(lanes) for lanes in (1, 8)}
POWER, IN_UNITS = kernel(_power), kernel(_in_units)


def run(method: ErrorControl, rates: Any, y0: Any, times: Any) -> Solution:
    """Integrate the oscillators to the last of some times."""
    address, tangent = KERNELS[method.lanes]
    return integrate(method, address, rates, y0, times[-1], times, tangent=tangent)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("rtol", [1e-4, 1e-10])
def test_units_of_powers_of_two_do_not_change_steps(kind: type[ErrorControl], rtol: float) -> None:
    """Scaling states or time changes no bit of steps, trials and dense output."""
    rates, y0 = np.array([1.0, 7.0, 0.5]), np.array([1.0, 0.0, -0.3, 0.4])
    times = np.linspace(0.0, 3.0, 14)
    one = run(kind(rtol, rtol / 8), rates, y0, times)
    for size, second in ((2.0**40, 1.0), (2.0**-40, 1.0), (1.0, 2.0**30), (2.0**20, 2.0**-30)):
        method = kind(rtol, size * rtol / 8)
        other = run(method, rates / second, size * y0, second * times)
        assert np.array_equal(other.knots, second * one.knots)
        assert np.array_equal(other.y, size * one.y)
        counts = ("steps", "rejected", "evaluations")
        assert [getattr(other, name) for name in counts] == [getattr(one, name) for name in counts]


@pytest.mark.parametrize("kind", [DOP853, Tsit5])
def test_explicit_steps_follow_the_error_estimate(kind: type[Explicit]) -> None:
    """Each step is the previous one times the factor of its error, by SciPy's DOP853."""
    rates, y0 = np.array([1.0, 7.0, 0.5]), np.array([1.0, 0.0, -0.3, 0.4])
    M = np.zeros((4, 4))
    M[0, 1], M[1, 0], M[2, 3], M[3, 2], M[3, 3] = 1.0, -1.0, 7.0, -7.0, -0.5
    rtol, atol, tableau = 1e-9, 1e-9, kind.tableau()
    solution = run(kind(rtol, atol), rates, y0, [5.0])
    h, order = np.diff(solution.knots), kind(1.0, 1.0).order
    assert solution.rejected == 0
    assert len(h) > 50
    book = scipy.integrate.DOP853(lambda t, y: M @ y, 0.0, y0, 1.0)  # noqa: ARG005
    for k in range(len(h) - 3):
        y, end = solution.states[k], solution.states[k + 1]
        K = np.zeros((tableau.stages + 1, 4))
        for j in range(len(K)):
            K[j] = M @ (y + h[k] * tableau.A[j, : len(K)] @ K)
        scale = atol + rtol * np.maximum(abs(y), abs(end))
        if kind is DOP853:
            error = book._estimate_error_norm(K, h[k], scale)
        else:
            error = h[k] * np.sqrt(np.mean((tableau.errors[0] @ K / scale) ** 2))
        growth = np.clip(0.9 * error ** (-1.0 / order), 1.0 / 3.0, 6.0)
        assert error < 1.0
        assert h[k + 1] == pytest.approx(growth * h[k], rel=1e-5)


@pytest.mark.parametrize("kind", [DOP853, Tsit5])
@pytest.mark.parametrize("power", [0.0, 0.25, 1.0, 4.0])
@pytest.mark.parametrize("rate", [1.0, 1e6])
def test_first_step_uses_two_derivatives(kind: type[Explicit], power: float, rate: float) -> None:
    """Hairer's first step in the unit of time of the second derivative."""
    rtol, atol, order = 1e-6, 1e-7, kind(1.0, 1.0).order
    solution = integrate(kind(rtol, atol), POWER, [rate, power], [1.0], 0.3 / rate, [])
    bend = (1.01**power - 1.0) / 0.01
    unit = 1.0 / np.sqrt(bend) if power else 1.0
    steepest = max(bend * unit**2, unit) / (atol + rtol)
    first = unit * (0.01 / steepest) ** (1.0 / order)
    assert rate * solution.knots[1] == pytest.approx(first, rel=1e-9)


def test_gauss_steps_follow_the_error_estimate() -> None:
    """Legendre coefficients of a circular motion are Bessel functions."""
    rtol, least = 1e-12, 1.0  # the absolute tolerance is that of states of size one
    solution = run(
        AdaptiveGauss(rtol, least * rtol), [1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [100.0]
    )
    h, t = np.diff(solution.knots), solution.knots[:-1]
    turn = np.exp(1j * (t + h / 2)) * 15.0 * (-1j) * spherical_jn(7, h / 2)  # that of exp(i t)
    sizes = least + abs(np.array([np.cos(t), np.sin(t)]))
    relative = h * np.array([turn.imag, turn.real]) / sizes
    error = np.sqrt((relative**2).sum(axis=0) / 4) ** (17 / 8) / rtol
    assert solution.rejected == 0
    assert len(h) > 40
    assert h[0] == pytest.approx(0.1 * np.sqrt(4.0) / 1.0, rel=1e-12)  # of rate 1 in size 1
    allowed = np.clip(0.9 * error ** (-1 / 17), 0.25, 4.0) * h
    assert h[1] <= allowed[0]  # with less, where the iteration of the first was slow
    np.testing.assert_allclose(h[2:-2], allowed[1:-3], rtol=1e-3)
    assert h[-1] == pytest.approx(h[-2], rel=1e-12)  # and no short one at the end


@pytest.mark.parametrize("rtol", [1e-4, 1e-6, 1e-8, 1e-10])
@pytest.mark.parametrize("unit", [1.0, 30.0, 1e3])
def test_iteration_error_and_number_of_iterations(rtol: float, unit: float) -> None:
    """The error is a fraction of the tolerance; an iteration gains a factor of about 6.

    In other units of the velocity, changes alternate: every other one is small by chance.
    """
    s = 8
    N = Polynomial([factorial(2 * s - k) / (factorial(k) * factorial(s - k)) for k in range(s + 1)])
    solution = integrate(AdaptiveGauss(rtol, rtol), IN_UNITS, [unit], [1.0, 0.0], 100.0, [])
    h, z = np.diff(solution.knots), solution.states @ [1.0, -1j * unit]
    assert unit > 1.0 or h[1] > 3.0 * h[0]  # whose error is nothing
    missed = z[1:] - z[:-1] * N(1j * h) / N(-1j * h)
    remaining = np.hypot(missed.real, missed.imag / unit) / np.sqrt(2) / rtol  # in the mean
    assert 1e-3 < np.median(remaining[1:]) < 0.05
    assert remaining[1:].max() < 0.15  # the first is guessed badly
    slowest = 1.0 / abs(N.roots()).min()  # of a turn, for a step of one radian
    assert 0.08 < np.median(h) * slowest < 0.25
