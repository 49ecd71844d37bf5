"""Signals, compiled and in CasADi's interpreter, against SciPy and closed forms."""

from __future__ import annotations

import copy
import math
import pickle
import subprocess
import sys
from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from native_functions import build
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

import pinred
from pinred import InputError
from pinred.common.arrays import Array
from pinred.signals import Constant, Expression, Fourier, Hold, Linear, Signal, Spline

ENDS = ["natural", "clamped", "not-a-knot", "periodic"]
TIMES = np.array([0.0, 0.1, 0.5, 0.7, 1.5, 2.0])
VALUES = np.array([0.3, -0.2, 0.9, 1.4, -0.7, 0.3])


def symbolic(signal: Signal, *, within: bool = False) -> list[Callable[[ArrayLike], Array]]:
    """Return the machine code and CasADi's own evaluation of a signal.

    Both map times (T,), or (2, T) of times and `within`, to all derivatives (3, T).
    """
    t = ca.SX.sym("t", 1 + within)
    value = signal.casadi(t[0], t[1]) if within else signal.casadi(t[0])
    rate = ca.gradient(value, t)[0]
    fast, slow = build(value, rate, ca.gradient(rate, t)[0], inputs=[t])
    return [
        lambda times: np.array([fast(column) for column in np.atleast_2d(times).T]).T,
        lambda times: (
            np.array(slow(np.atleast_2d(times))).reshape(-1, 3).T
            if np.size(times) == 1 + within
            else np.hstack([np.array(slow(column)) for column in np.atleast_2d(times).T])
        ),
    ]


def numbers(signal: Signal, times: ArrayLike) -> Array:
    """Return value, rate and acceleration, (3, T)."""
    return np.array([signal.value(times), signal.rate(times), signal.acceleration(times)])


def routes(signal: Signal) -> list[Callable[[ArrayLike], Array]]:
    """Return the three ways to evaluate a signal."""
    return [*symbolic(signal), lambda times: numbers(signal, times)]


def random_table(seed: int, size: int) -> tuple[Array, Array]:
    """Return a table of uneven times, some of them far from zero."""
    rng = np.random.default_rng(seed)
    times = rng.choice([0.0, -30.0, 1e4]) + np.cumsum(rng.uniform(0.05, 1.0, size))
    return times, rng.normal(size=size)


@pytest.mark.slow
@given(seed=st.integers(0, 2**32 - 1), size=st.integers(2, 12), end=st.sampled_from(ENDS))
@settings(max_examples=40)
def test_spline_equals_scipy(seed: int, size: int, end: str) -> None:
    """Value, rate and acceleration, also at the entries."""
    times, values = random_table(seed, size)
    if end == "periodic":
        values[-1] = values[0]
    spline = Spline(times.tolist(), values.tolist(), end=end)  # type: ignore[arg-type]
    curve = CubicSpline(times, values, bc_type=end)
    at = np.concatenate([times, np.random.default_rng(seed).uniform(times[0], times[-1], 30)])
    expected = np.array([curve(at, order) for order in range(3)])
    scale = np.abs(curve.c).max()
    for route in routes(spline):
        np.testing.assert_allclose(route(at), expected, rtol=1e-12, atol=1e-14 * scale)
    np.testing.assert_allclose(spline.value(times), values, atol=1e-13)


def test_spline_reproduces_cubics() -> None:
    """A clamped spline for a cubic with zero end rates, not-a-knot for any."""
    smooth = Spline([0.0, 0.2, 0.7, 1.0], [0.0, 0.104, 0.784, 1.0], end="clamped")
    at = np.linspace(0, 1, 23)
    for route in routes(smooth):
        expected = [3 * at**2 - 2 * at**3, 6 * at - 6 * at**2, 6 - 12 * at]
        np.testing.assert_allclose(route(at), expected, atol=2e-14)
    cubic = Spline(TIMES, TIMES**3 - 2 * TIMES + 1, end="not-a-knot")
    at = np.linspace(0, 2, 23)
    for route in routes(cubic):
        np.testing.assert_allclose(
            route(at), [at**3 - 2 * at + 1, 3 * at**2 - 2, 6 * at], atol=1e-12
        )


def test_spline_satisfies_its_end_conditions() -> None:
    """At both ends."""
    ends = [0.0, 2.0]
    assert np.abs(Spline(TIMES, VALUES).acceleration(ends)).max() < 1e-13
    assert np.abs(Spline(TIMES, VALUES, end="clamped").rate(ends)).max() < 1e-13
    first, last = numbers(Spline(TIMES, VALUES, end="periodic"), ends).T
    np.testing.assert_allclose(first, last, atol=1e-12)
    assert abs(first[1]) > 0.1


@pytest.mark.parametrize(
    ("signal", "smooth"), [(Spline(TIMES, VALUES), 2), (Linear(TIMES, VALUES), 0)]
)
def test_breaks_have_the_stated_smoothness(signal: Signal, smooth: int) -> None:
    """Exactly so many derivatives agree from both sides of a break, by `within`."""
    assert signal.smoothness == smooth
    assert signal.span == (0.0, 2.0)
    np.testing.assert_array_equal(signal.breaks, TIMES[1:-1])
    for route in symbolic(signal, within=True):
        before = route([signal.breaks, signal.breaks - 0.05])
        after = route([signal.breaks, signal.breaks + 0.05])
        np.testing.assert_allclose(before[: smooth + 1], after[: smooth + 1], atol=1e-12)
        if smooth < 2:
            assert (np.abs(before - after)[smooth + 1] > 0.1).all()


def test_linear_and_hold_equal_brute_force() -> None:
    """NumPy's straight lines, and steps that start at their times."""
    at = np.concatenate([TIMES[:-1], np.random.default_rng(1).uniform(0, 2, 50)])
    piece = [max(k for k in range(6) if TIMES[k] <= t) for t in at]
    slope = [(VALUES[k + 1] - VALUES[k]) / (TIMES[k + 1] - TIMES[k]) for k in piece]
    zero = np.zeros(len(at))
    for route in routes(Linear(TIMES, VALUES)):
        expected = [np.interp(at, TIMES, VALUES), slope, zero]
        np.testing.assert_allclose(route(at), expected, rtol=1e-13, atol=1e-15)
    hold = Hold(TIMES, VALUES)
    assert hold.span == (0.0, math.inf)
    assert hold.smoothness == -1
    np.testing.assert_array_equal(hold.breaks, TIMES[1:])
    for route in routes(hold):
        np.testing.assert_array_equal(route(at), [VALUES[piece], zero, zero])
        np.testing.assert_array_equal(route([2.0, 7.0])[0], VALUES[[5, 5]])
    for route in symbolic(hold, within=True):
        np.testing.assert_array_equal(route([hold.breaks, hold.breaks - 0.01])[0], VALUES[:-1])
    for route in routes(Hold([1.0], [4.5])):
        np.testing.assert_array_equal(route([1.0, 3.0]), [[4.5, 4.5], [0, 0], [0, 0]])


@pytest.mark.parametrize("kind", [Spline, Linear])
@pytest.mark.sampled
def test_small_values_keep_digits_beside_large_ones(kind: type[Signal]) -> None:
    """At late times, beside values 1e12 times as large."""
    rng = np.random.default_rng(2)
    times = 1e6 + np.arange(200) / 8.0
    values = rng.normal(size=200)
    values[20] = 1e12
    at = rng.uniform(times[100], times[-1], 100)
    signal = kind(times, values)  # type: ignore[call-arg]
    curve = CubicSpline(times, values, bc_type="natural")
    expected = curve(at) if kind is Spline else np.interp(at, times, values)
    for route in routes(signal):
        np.testing.assert_allclose(route(at)[0], expected, rtol=1e-10, atol=1e-13)


@pytest.mark.slow
def test_large_table_compiles_to_few_instructions() -> None:
    """A thousand entries, derivatives included."""
    rng = np.random.default_rng(3)
    times = np.cumsum(rng.uniform(0.01, 0.02, 1000))
    values = np.sin(times)
    spline = Spline(times, values)
    t = ca.SX.sym("t")
    value = spline.casadi(t)
    rate = ca.gradient(value, t)
    for expression, most in ((value, 18), (ca.vertcat(value, rate, ca.gradient(rate, t)), 18)):
        assert ca.Function("f", [t], [expression]).n_instructions() <= most * 1000
    at = rng.uniform(times[0], times[-1], 100)
    curve = CubicSpline(times, values, bc_type="natural")
    fast, _ = symbolic(spline)
    np.testing.assert_allclose(fast(at), [curve(at, k) for k in range(3)], atol=1e-11)


@given(
    seed=st.integers(0, 2**32 - 1), cosines=st.integers(0, 6), sines=st.integers(0, 6),
    period=st.floats(0.1, 50),
)  # fmt: skip
@settings(max_examples=30)
def test_fourier_equals_sum_of_exponentials(
    seed: int, cosines: int, sines: int, period: float
) -> None:
    """Σ Re cₖ exp(2πi k t/T) and its derivatives."""
    rng = np.random.default_rng(seed)
    a, b, mean = rng.normal(size=cosines), rng.normal(size=sines), float(rng.normal())
    signal = Fourier(mean, a, b, period)
    at = rng.uniform(-2 * period, 2 * period, 20)
    c = np.zeros(max(cosines, sines), dtype=complex)
    c[:cosines] += a
    c[:sines] -= 1j * b
    factor = 2j * np.pi * np.arange(1, len(c) + 1) / period
    waves = np.exp(np.outer(at, factor))
    expected = np.array([(waves @ (c * factor**n)).real for n in range(3)])
    expected[0] += mean
    size = [np.abs(c * factor**n).sum() + abs(mean) + 1e-12 for n in range(3)]
    for route in routes(signal):
        assert (np.abs(route(at) - expected).max(axis=1) <= 1e-12 * np.array(size)).all()
    assert signal.breaks.size == 0
    assert signal.span == (-math.inf, math.inf)


def test_expression_and_constant_equal_closed_forms() -> None:
    """A damped swing, and zero."""
    at = np.linspace(-2, 3, 11)
    swing = Expression("0.3 * sin(2*t) * exp(-t/5)")
    rotor = -0.2 + 2j  # Im exp((−1/5 + 2i) t)
    expected = [(0.3 * rotor**n * np.exp(rotor * at)).imag for n in range(3)]
    for route in routes(swing):
        np.testing.assert_allclose(route(at), expected, rtol=1e-13, atol=1e-14)
    for route in [*routes(Constant(0.7)), *routes(Expression("0.7"))]:
        np.testing.assert_array_equal(route(at), [[0.7] * 11, [0.0] * 11, [0.0] * 11])
    assert swing.smoothness == math.inf
    for text in ("abs(t)", "where(t < 1, 0, t)", "floor(t)", "min(t, 1)", "(t > 1)*t", "sign(t)"):
        assert Expression(text).smoothness == -1


EVERY = [
    Constant(1.5), Expression("t**2"), Fourier(0.1, [1, 2], [3], 2.0), Spline(TIMES, VALUES),
    Linear(TIMES, VALUES), Hold(TIMES, VALUES),
]  # fmt: skip


@pytest.mark.parametrize("signal", EVERY, ids=lambda s: type(s).__name__)
def test_signals_accept_times_of_any_shape(signal: Signal) -> None:
    """A copy of the signal gives the same values."""
    at = np.linspace(0.05, 1.95, 6).reshape(2, 3)
    for name in ("value", "rate", "acceleration"):
        values = getattr(signal, name)(at)
        assert values.shape == (2, 3)
        assert getattr(signal, name)(0.05).shape == ()
        assert getattr(signal, name)(0.05) == values[0, 0]
        assert getattr(signal, name)([]).shape == (0,)
        for other in (copy.deepcopy(signal), pickle.loads(pickle.dumps(signal))):
            np.testing.assert_array_equal(getattr(other, name)(at), values)


def test_table_copies_its_arrays() -> None:
    """The caller's arrays stay writable; those of the table are read-only."""
    times, values = TIMES.copy(), VALUES.copy()
    spline = Spline(times, values)
    before = spline.value(0.3)
    times += 1
    values[:] = 0
    assert spline.value(0.3) == before
    for array in (spline.times, spline.values, spline.breaks, Fourier(0, [1], [], 1).cosines):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1  # type: ignore[index]


NAN, INF = math.nan, math.inf


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Spline([0, 1, 1, 2], [0] * 4), r"entry 2 \(1.0 s\) follows 1.0 s"),
        (lambda: Linear([0, 2, 1], [0] * 3), r"times of a Linear .* entry 2 \(1.0 s\) follows 2.0"),
        (lambda: Hold([0, NAN], [0, 0]), "times of a Hold must be finite, but entry 1 is nan"),
        (lambda: Spline([0, 1], [0, INF]), "values of a Spline must be finite, but entry 1 is inf"),
        (lambda: Spline([0, 1], [0, 1, 2]), r"shape \(2,\), got \(3,\)"),
        (lambda: Spline([[0, 1]], [0, 1]), "list of numbers"),
        (lambda: Spline([0], [1]), "needs at least 2 entries, got 1"),
        (lambda: Hold([], []), "needs at least 1 entries, got 0"),
        (lambda: Spline(["a", "b"], [0, 1]), "must be numbers"),
        (lambda: Fourier(0, range(1001), [], 1), "1001 entries, .* keep only as many"),
        (lambda: Spline([0, 1], [0, 1], end="free"), "natural, clamped, not-a-knot, periodic"),  # type: ignore[arg-type]
        (lambda: Spline([0, 1, 2], [0, 1, 2], end="periodic"), "got 0.0 and 2.0"),
        (lambda: Spline([0, 5e-324, 1], [0, 1e300, 2]), "times too close"),
        (lambda: Linear([0, 1, 1 + 1e-15], [0, 1, 1e300]), r"after entry 1 \(1.0 s\)"),
        (lambda: Constant(NAN), "value of a Constant"),
        (lambda: Constant([1, 2]), "one finite number"),  # type: ignore[arg-type]
        (lambda: Fourier(INF, [], [], 1), "mean of a Fourier"),
        (lambda: Fourier(0, [1, NAN], [], 1), "cosines of a Fourier .* entry 1"),
        (lambda: Fourier(0, [], [1], 0), "period of a Fourier"),
        (lambda: Fourier(0, [], [1], 1e-300), "overflows"),
        (lambda: Expression("0.3*sin(2*x)"), "x is not a name"),
        (lambda: Spline(TIMES, VALUES).value(2.1), r"from 0.0 s to 2.0 s, .*Spline.* got 2.1 s"),
        (lambda: Hold(TIMES, VALUES).rate([0.1, -0.1]), "got -0.1 s"),
        (lambda: Constant(1).value(NAN), "finite"),
        (lambda: Fourier(0, [1], [], 1).acceleration(INF), "finite"),
        (lambda: Expression("sqrt(t)").value([1, -1]), r"value of .*sqrt.* is nan at t = -1.0 s"),
        (lambda: Expression("sqrt(t)").rate(0), r"rate of .*sqrt.* is inf at t = 0.0 s"),
    ],
)  # fmt: skip
def test_invalid_signals_are_rejected(make: Callable[[], object], message: str) -> None:
    """Invalid coefficients, and times outside of the span."""
    with pytest.raises(InputError, match=message):
        make()


def test_import_needs_neither_casadi_nor_scipy() -> None:
    """They are imported when a signal is first used."""
    assert pinred.signals.Spline is Spline
    code = (
        "import sys, pinred; pinred.signals.Constant(1).value(2); "
        "sys.exit(bool({'casadi', 'scipy', 'pinocchio'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
