"""Step control: units change no bit, and steps are as long as their error lets them be."""

from __future__ import annotations

from math import factorial
from typing import Any

import numpy as np
import pytest
import scipy.integrate
from numpy.polynomial import Polynomial
from scipy.special import spherical_jn
from stiff_kernels import kernels

from pinred import DOP853, AdaptiveGauss, Tsit5
from pinred.integrators.integrate import integrate
from pinred.integrators.methods import METHODS, ErrorControl, Explicit
from pinred.integrators.solution import Solution

KINDS = [kind for kind in METHODS.values() if issubclass(kind, ErrorControl)]


def _wide(lanes: int) -> tuple[int, Any]:
    """Two oscillators, with angular velocities p[0] and p[1], and a little friction p[2]."""

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


KERNELS = {lanes: _wide(lanes) for lanes in (1, 8)}
POWER, _ = kernels(_power, lambda y, p, v, d: None)  # noqa: ARG005


def run(method: ErrorControl, rates: Any, y0: Any, times: Any) -> Solution:
    """The oscillators up to the last of some times."""
    address, tangent = KERNELS[method.lanes]
    return integrate(method, address, rates, y0, times[-1], times, tangent=tangent)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("rtol", [1e-4, 1e-10])
def test_units_of_powers_of_two_change_no_bit(kind: type[ErrorControl], rtol: float) -> None:
    """Neither those of states nor that of time: in steps, trials and in states between them."""
    rates, y0 = np.array([1.0, 7.0, 0.5]), np.array([1.0, 0.0, -0.3, 0.4])
    times = np.linspace(0.0, 3.0, 14)
    one = run(kind(rtol, rtol / 8), rates, y0, times)
    for size, second in ((2.0**40, 1.0), (2.0**-40, 1.0), (1.0, 2.0**30), (2.0**20, 2.0**-30)):
        method = kind(rtol, size * rtol / 8)
        other = run(method, rates / second, size * y0, second * times)
        assert np.array_equal(other.knots, second * one.knots)
        assert np.array_equal(other.y, size * one.y)
        told = ("steps", "rejected", "evaluations")
        assert [getattr(other, name) for name in told] == [getattr(one, name) for name in told]


@pytest.mark.parametrize("kind", [DOP853, Tsit5])
def test_steps_are_as_long_as_the_error_lets_by_the_book(kind: type[Explicit]) -> None:
    """Each is the one before times what its error allows: SciPy's estimate for DOP853."""
    rates, y0 = np.array([1.0, 7.0, 0.5]), np.array([1.0, 0.0, -0.3, 0.4])
    M = np.zeros((4, 4))
    M[0, 1], M[1, 0], M[2, 3], M[3, 2], M[3, 3] = 1.0, -1.0, 7.0, -7.0, -0.5
    rtol, atol, tableau = 1e-9, 1e-9, kind.tableau()
    found = run(kind(rtol, atol), rates, y0, [5.0])
    h, order = np.diff(found.knots), kind(1.0, 1.0).order
    assert found.rejected == 0
    assert len(h) > 50
    book = scipy.integrate.DOP853(lambda t, y: M @ y, 0.0, y0, 1.0)  # noqa: ARG005
    for k in range(len(h) - 3):
        y, end = found.states[k], found.states[k + 1]
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
def test_the_first_step(kind: type[Explicit], power: float, rate: float) -> None:
    """Hairer's, from the first two derivatives, in units of the time that the second tells."""
    rtol, atol, order = 1e-6, 1e-7, kind(1.0, 1.0).order
    found = integrate(kind(rtol, atol), POWER, [rate, power], [1.0], 0.3 / rate, [])
    bend = (1.01**power - 1.0) / 0.01
    unit = 1.0 / np.sqrt(bend) if power else 1.0
    steepest = max(bend * unit**2, unit) / (atol + rtol)
    first = unit * (0.01 / steepest) ** (1.0 / order)
    assert rate * found.knots[1] == pytest.approx(first, rel=1e-9)


def test_steps_are_as_long_as_their_error_lets() -> None:
    """Rates along a circle have Legendre coefficients in Bessel functions: so has the error."""
    rtol, least = 1e-12, 1.0  # the absolute tolerance is that of states of size one
    found = run(AdaptiveGauss(rtol, least * rtol), [1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [100.0])
    h, t = np.diff(found.knots), found.knots[:-1]
    turn = np.exp(1j * (t + h / 2)) * 15.0 * (-1j) * spherical_jn(7, h / 2)  # that of exp(i t)
    sizes = least + abs(np.array([np.cos(t), np.sin(t)]))
    relative = h * np.array([turn.imag, turn.real]) / sizes
    error = np.sqrt((relative**2).sum(axis=0) / 4) ** (17 / 8) / rtol
    assert found.rejected == 0
    assert len(h) > 40
    assert h[0] == pytest.approx(0.1 * np.sqrt(4.0) / 1.0, rel=1e-12)  # of rate 1 in size 1
    allowed = np.clip(0.9 * error ** (-1 / 17), 0.25, 4.0) * h
    assert h[1] <= allowed[0]  # with less, where the iteration of the first was slow
    np.testing.assert_allclose(h[2:-2], allowed[1:-3], rtol=1e-3)
    assert h[-1] == pytest.approx(h[-2], rel=1e-12)  # and no short one at the end


@pytest.mark.parametrize("rtol", [1e-4, 1e-6, 1e-8, 1e-10])
def test_what_iterations_leave_and_what_they_cost(rtol: float) -> None:
    """A part of the tolerance, by Padé's approximation; a turn gains a factor of some 6."""
    s = 8
    N = Polynomial([factorial(2 * s - k) / (factorial(k) * factorial(s - k)) for k in range(s + 1)])
    found = run(AdaptiveGauss(rtol, rtol), [1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [100.0])
    h, z = np.diff(found.knots), found.states[:, 0] - 1j * found.states[:, 1]
    assert h[1] == pytest.approx(4.0 * h[0], rel=1e-12)  # whose error is nothing
    left = abs(z[1:] - z[:-1] * N(1j * h) / N(-1j * h)) / np.sqrt(4) / rtol  # in the mean
    assert 1e-3 < np.median(left[1:]) < 0.05
    assert left[1:].max() < 0.15  # the first is guessed badly
    slowest = 1.0 / abs(N.roots()).min()  # of a turn, for a step of one radian
    assert 0.12 < np.median(h) * slowest < 0.25
