"""Hairer's codes: accuracy, number of evaluations, errors, smallest rates."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg.lapack
from commands import python
from scipy.integrate import ode

from pinred.common.arrays import Array
from pinred.judge import reference_integrators
from pinred.judge.reference_integrators import Hairer


class Oscillator:
    """An oscillator of 1 rad/s that counts its evaluations."""

    calls = 0

    def __call__(self, _: float, y: Array) -> Array:
        """Return the rate of (x, ẋ)."""
        self.calls += 1
        return np.array([y[1], -y[0]])


def solve_oscillator(method: str, times: Array, rate: Oscillator | None = None) -> Array:
    """Return the first component at the times, from 1 at rest."""
    solver = Hairer(rate or Oscillator(), method, np.array([1.0, 0.0]), 0.0, 1e-12, 1e-14, 1e6)
    result = [solver.integrate(float(t)) for t in times]
    return np.array([y[0] for y in result if y is not None])


@pytest.mark.parametrize(("method", "stages"), [("dop853", 12), ("dopri5", 6)])
def test_near_times_take_one_step_each(method: str, stages: int) -> None:
    """Two of three evaluations are saved; the loop's first steps are ten times too short."""
    rate, times = Oscillator(), np.linspace(0.005, 1.0, 200)
    np.testing.assert_allclose(solve_oscillator(method, times, rate), np.cos(times), atol=1e-12)
    assert rate.calls <= 1.1 * (stages + 1) * len(times)


@pytest.mark.parametrize("method", ["dop853", "dopri5"])
@pytest.mark.sampled
def test_spans_of_mixed_lengths_stay_accurate(method: str) -> None:
    """The first step learned from short spans does not harm long ones, and vice versa."""
    spans = np.random.default_rng(5).choice([1e-9, 1e-3, 0.3, 20.0], 60)
    times = np.cumsum(spans)
    np.testing.assert_allclose(solve_oscillator(method, times), np.cos(times), atol=3e-10)
    rate, near = Oscillator(), np.linspace(1e-3, 1.5, 1500)
    late = np.append(
        near, near[-1] + 20.0
    )  # the learned step may be long, but not longer than the span
    np.testing.assert_allclose(
        solve_oscillator(method, late, rate)[-1], np.cos(late[-1]), atol=3e-11
    )


def test_long_span_needs_no_more_evaluations() -> None:
    """Steps over a long span are not shorter than those of the plain loop."""
    alone, told = Oscillator(), Oscillator()
    solve_oscillator("dop853", np.array([200.0]), alone)
    solve_oscillator("dop853", np.linspace(2.0, 200.0, 100), told)
    assert told.calls <= 1.25 * alone.calls


METHODS = ["dop853", "dopri5"]


@pytest.mark.parametrize("method", METHODS)
def test_first_span_equals_plain_loop(method: str) -> None:
    """Evaluations and results are identical, because no first step has been learned."""
    alone, told = Oscillator(), Oscillator()
    loop = ode(alone).set_integrator(method, rtol=1e-12, atol=1e-14, nsteps=10_000)
    loop.set_solout(lambda *_: 0)  # without it, SciPy may evaluate more often
    loop.set_initial_value(np.array([1.0, 0.0]), 0.0)
    assert solve_oscillator(method, np.array([7.0]), told)[0] == loop.integrate(7.0)[0]
    assert told.calls == alone.calls


@pytest.mark.parametrize("method", METHODS)
def test_error_of_rate_is_raised(method: str) -> None:
    """Any exception is raised, and no evaluation follows."""
    calls = []

    def rate(t: float, y: Array) -> Array:
        calls.append(t)
        if len(calls) > 30:
            raise LookupError("here")
        return -y

    solver = Hairer(rate, method, np.ones(1), 0.0, 1e-10, 1e-12, 9.0)
    with pytest.raises(LookupError, match="here"):
        solver.integrate(9.0)
    assert len(calls) == 31
    assert 0.0 < solver.t < 1.0  # the loop ends with the step


@pytest.mark.parametrize("method", METHODS)
def test_integration_over_pole_returns_none(method: str) -> None:
    """The solution y = 1/(1 − t) has no state beyond t = 1; there is no warning."""
    solver = Hairer(lambda _, y: y**2, method, np.ones(1), 0.0, 1e-8, 1e-10, 2.0)
    half = solver.integrate(0.5)
    assert half == pytest.approx(2.0, rel=1e-6)
    assert solver.integrate(2.0) is None


@pytest.mark.parametrize("begin", [0.0, 10.0])
@pytest.mark.parametrize("time", [0.03, 1.0, 100.0])
@pytest.mark.parametrize("method", METHODS)
def test_smallest_rates_count_as_zero(method: str, time: float, begin: float) -> None:
    """Rates that change a number by less than 1e-120 until the end are zero."""
    for fraction, moves in ((0.3, False), (3.0, True)):
        rate, end = fraction * 1e-120 / max(time, 1.0), begin + time

        def steady(_: float, y: Array, rate: float = rate) -> Array:
            return rate + 0.0 * y

        solver = Hairer(steady, method, np.zeros(1), begin, 1e-8, 1e-16, end)
        y = solver.integrate(end)
        assert y is not None
        assert y[0] == pytest.approx(rate * time if moves else 0.0, rel=1e-9, abs=0.0)


def test_files_of_scipy_are_loaded_without_their_packages() -> None:
    """Importing the packages takes longer than a comparison; the objects are the same files'."""
    code = (
        "import sys, numpy as np, pinred.judge.audit\n"
        "from pinred.judge.reference_integrators import dposv, ode\n"
        "print('scipy.integrate' in sys.modules, 'scipy.linalg' in sys.modules)\n"
        "import inspect, scipy.integrate, scipy.linalg.lapack\n"
        "print(inspect.getsource(ode) == inspect.getsource(scipy.integrate.ode))\n"
        "print(dposv.__doc__ == scipy.linalg.lapack.dposv.__doc__)"
    )
    assert python(code).split() == ["False", "False", "True", "True"]


def test_coefficients_of_dense_output_are_those_of_scipy() -> None:
    """The file defines them for the class DOP853."""
    expected = scipy.integrate.DOP853
    assert np.array_equal(reference_integrators.A_EXTRA, expected.A_EXTRA)
    assert np.array_equal(reference_integrators.C_EXTRA, expected.C_EXTRA)
    assert np.array_equal(reference_integrators.D, expected.D)


def test_objects_of_other_scipy_versions_are_imported_from_their_packages(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where the file has another name, the package is imported."""
    monkeypatch.setattr(reference_integrators, "_FOLDER", Path("/proc/nothing"))
    for folder in ("integrate", "linalg"):  # the entries of sys.modules are restored afterwards
        package = f"{reference_integrators.__name__}_{folder}"
        monkeypatch.setitem(sys.modules, package, sys.modules[package])
        for module in ("_ode", "_flapack"):
            monkeypatch.delitem(sys.modules, f"{package}.{module}", raising=False)
    assert (
        reference_integrators._load("integrate._ode", "ode", "scipy.integrate")
        is scipy.integrate.ode
    )
    result = reference_integrators._load("linalg._flapack", "dposv", "scipy.linalg.lapack")
    assert result is scipy.linalg.lapack.dposv
