"""Tests of the integrators of the reference solution and of the time limit of a comparison."""

from __future__ import annotations

import sys
import time
from functools import partial
from itertools import count
from pathlib import Path

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg.lapack
from commands import python
from scipy.integrate import ode
from tampering import offset, tampered

import pinred
from pinred.common.arrays import Array
from pinred.judge import reference_integrators
from pinred.judge.compare import _compare
from pinred.judge.reference_integrators import (
    NODES,
    AbaStopped,
    Hairer,
    StiffIntegrator,
    TimeBudget,
    default_budget,
    jacobian,
    spectral_radius,
)
from pinred.judge.reference_solution import FINEST, FullState
from pinred.judge.verdict import Verdict


@pytest.fixture(scope="module")
def traj() -> pinred.Trajectory:
    """Two seconds of the falling cat."""
    return pinred.simulate(pinred.load("falling_cat"), seed=1, duration=2.0)


def counted_budget(seconds: float) -> TimeBudget:
    """Return a budget whose clock advances by one second at each reading."""
    clock = count()
    return TimeBudget(seconds, lambda: float(next(clock)), count(0.0, 1e9).__next__)


@pytest.mark.parametrize("evaluations", [0, 60, 500])
def test_exhausted_budget_gives_no_verdict(
    traj: pinred.Trajectory, evaluations: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The clock counts evaluations of ABA, so the time that it reaches is the same everywhere."""
    budget = partial(counted_budget, evaluations + 0.5)
    monkeypatch.setitem(_compare.__globals__, "TimeBudget", lambda _: budget())
    report = pinred.compare(traj)
    assert report.verdict is Verdict.CANNOT_TELL
    expected = f"exceeded {evaluations + 0.5:g} s of processor time; it reached t = "
    assert expected in report.reasons[-1]
    reached = float(report.reasons[-1].partition("t = ")[2].partition(" s")[0])
    assert 0.0 <= reached < 2.0
    assert (reached > 0.0) == (evaluations > 0)
    assert "verdict: CANNOT TELL" in str(report)


def test_wrong_steps_fail_without_budget(traj: pinred.Trajectory) -> None:
    """Equations and defects of steps need no solution by ABA, so they are judged in any case."""
    wrong = tampered(traj, offset("x", 0, 1e-3))
    assert pinred.compare(wrong, budget=1e-9).verdict is Verdict.FAILED


def test_budget_that_suffices_changes_nothing(traj: pinred.Trajectory) -> None:
    """The verdict and the errors are those without a limit."""
    limited, free = pinred.compare(traj, budget=1e6), pinred.compare(traj, budget=1e9)
    assert limited.passed
    np.testing.assert_array_equal(limited.shape_errors, free.shape_errors)


def test_motion_that_aba_cannot_follow_gives_no_verdict(
    traj: pinred.Trajectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A failure of all integrators is a verdict, not an error."""
    monkeypatch.setattr(Hairer, "integrate", lambda *_: None)
    nothing = None, np.zeros((1, 1))
    monkeypatch.setattr(StiffIntegrator, "integrate", lambda *_: nothing)
    began = time.perf_counter()
    report = pinred.compare(traj)
    assert 0.0 < report.wall_full < time.perf_counter() - began
    assert report.verdict is Verdict.CANNOT_TELL
    assert "cannot be integrated to" in report.reasons[-1]
    assert "it reached t = 0 s" in report.reasons[-1]


def test_budget_counts_from_its_creation() -> None:
    """Processor time that was spent before does not matter."""
    clock, wall = count(100), count(1000)
    budget = TimeBudget(2.5, lambda: float(next(clock)), lambda: float(next(wall)))
    assert [budget.is_exceeded() for _ in range(6)] == [False] * 5 + [True]


@pytest.mark.parametrize(("wall", "seconds"), [(0.0, 30.0), (0.06, 30.0), (0.2, 100.0)])
def test_default_budget_is_the_longer_one(wall: float, seconds: float) -> None:
    """Thirty seconds, or 500 times the wall time of the simulation."""
    assert default_budget(wall) == pytest.approx(seconds)


def test_limited_rate_stops_after_the_budget() -> None:
    """The error has the time of the evaluation."""
    rate = counted_budget(1.5).limit(lambda _, y: y)
    assert rate(0.1, np.ones(1)) == 1.0
    with pytest.raises(AbaStopped, match=r"1.5 s of processor time; it reached t = 0.2 s") as stop:
        rate(0.2, np.ones(1))
    assert stop.value.time == 0.2


def test_time_of_other_programs_does_not_count() -> None:
    """The machine is busy for an hour, of which the comparison has one second."""
    wall, clock = iter([0.0, 3600.0, 3601.0, 3609.0, 3611.0]), iter([0.0, 1.0, 11.0])
    budget = TimeBudget(10.0, lambda: next(clock), lambda: next(wall))
    assert [budget.is_exceeded() for _ in range(4)] == [False, False, False, True]


@pytest.mark.parametrize("budget", [0.0, -1.0, float("nan"), "long"])
def test_invalid_budget_is_rejected(traj: pinred.Trajectory, budget: float) -> None:
    """A budget is a positive number of seconds."""
    with pytest.raises(pinred.InputError, match="budget"):
        pinred.compare(traj, budget=budget)


@pytest.mark.parametrize(("damping", "duration"), [(-1e3, 6e-5), (1e6, 0.02)])
def test_stiff_and_unstable_scenes_end_with_a_verdict(damping: float, duration: float) -> None:
    """Neither scene can be followed within the budget; the judge raises nothing."""
    force = pinred.forces.Damper("bend", damping)
    traj = pinred.simulate(pinred.load("falling_cat"), seed=1, duration=duration, forces=[force])
    report = pinred.compare(traj, budget=0.02)
    # Defects of stiff steps are large, so the verdict on them may be FAILED.
    expected = {Verdict.CANNOT_TELL} if damping < 0.0 else {Verdict.CANNOT_TELL, Verdict.FAILED}
    assert report.verdict in expected
    assert "it reached t = " in report.reasons[-1]


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


END = 20.0


class RecordedOscillator:
    """An oscillator of 1 rad/s, a tenth of whose rates depends on time; it records the times."""

    def __init__(self) -> None:
        """Start recording."""
        self.times: list[float] = []

    def __call__(self, t: float, y: Array) -> Array:
        """Return the rate of (x, ẋ)."""
        self.times.append(t)
        return np.array([y[1], -y[0]]) + 0.1 * np.array([-np.sin(t) - y[1], y[0] - np.cos(t)])


def solver(rate: RecordedOscillator, rtol: float) -> Hairer:
    """Return an initial value problem of an oscillation that starts at 1."""
    return Hairer(rate, "dop853", np.array([1.0, 0.0]), 0.0, rtol, 1e-2 * rtol, END)


@pytest.mark.parametrize("rtol", [1e-6, 1e-9, 1e-12, FINEST[0]])
def test_dense_output_is_as_accurate_as_steps(rtol: float) -> None:
    """Errors within steps are at most four times those of the steps' ends."""
    problem, times = solver(RecordedOscillator(), rtol), np.linspace(0.03, END, 400)
    end = problem.integrate(END, times.tolist())
    dense = problem.dense()
    assert end is not None
    assert dense is not None
    exact = np.array([np.cos(times), -np.sin(times)]).T
    at_ends = dense(dense.ends) - np.array([np.cos(dense.ends), -np.sin(dense.ends)]).T
    assert np.abs(dense(times) - exact).max() < 4.0 * np.abs(at_ends).max() + 1e-15
    assert np.abs(dense(times) - exact).max() < 4.0 * rtol + 1e-15
    np.testing.assert_allclose(dense(np.array([END]))[0], end, rtol=0.0, atol=1e-15)


def test_dense_output_costs_three_evaluations_a_step() -> None:
    """They are made only in steps with targets; the steps are those of a run without targets."""
    alone, dense = RecordedOscillator(), RecordedOscillator()
    solver(alone, 1e-10).integrate(END)
    problem = solver(dense, 1e-10)
    problem.integrate(END, [3.0, 3.001, 15.0, END])
    assert dense.times == alone.times
    steps = problem.dense()
    assert steps is not None
    assert len(steps.starts) == 3
    for target, a, b in zip([3.0, 15.0, END], steps.starts, steps.ends, strict=True):
        assert a < target <= b
    assert len(dense.times) == len(alone.times) + 9


def test_dense_output_covers_the_last_span_only() -> None:
    """Targets at the start of a span belong to the span before it."""
    problem = solver(RecordedOscillator(), 1e-10)
    assert problem.dense() is None
    problem.integrate(1.0, [0.3])
    problem.integrate(END, [1.0, 2.0])
    dense = problem.dense()
    assert dense is not None
    assert (dense.starts >= 1.0).all()
    np.testing.assert_allclose(dense(np.array([2.0]))[0, 0], np.cos(2.0), atol=1e-10)
    problem.integrate(END + 1.0)
    assert problem.dense() is None


def test_run_at_many_times_costs_little_more_than_at_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Without dense output, 1000 times cost at least 12 000 evaluations."""
    scene = pinred.simulate(pinred.load("falling_cat"), duration=2.0).scene
    calls, rate = [], FullState.rate

    def counted(full: FullState, t: float, y: Array) -> Array:
        calls.append(t)
        return rate(full, t, y)

    monkeypatch.setattr(FullState, "rate", counted)
    full, start = FullState(scene), scene.start
    y0 = full.state(start.pose, start.x, start.xi, start.xdot)
    end = full.run(y0, np.array([2.0]), 1e-10, 1e-12)
    alone = len(calls)
    motion = full.run(y0, np.linspace(0.0, 2.0, 1001), 1e-10, 1e-12)
    assert len(calls) - alone < 1.3 * alone
    np.testing.assert_allclose(motion.q[-1], end.q[-1], rtol=0.0, atol=1e-14)
    np.testing.assert_array_equal(motion.x[0], start.x)


def integrate(rate: object, y0: list[float], end: float, tolerance: float) -> StiffIntegrator:
    """Return an integrator that has not yet started."""
    y = np.array(y0)
    return StiffIntegrator(rate, y, 0.0, tolerance, np.ones(len(y)), end)  # type: ignore[arg-type]


@pytest.mark.parametrize("decay", [1.0, 1e3, 1e6, 1e9])
def test_decay_to_known_motion_is_accurate_in_few_steps(decay: float) -> None:
    """Y' = −λ (y − cos t) − sin t has the solution cos t + e^(−λt), however fast it decays."""

    def rate(t: float, y: Array) -> Array:
        return np.asarray(-decay * (y - np.cos(t)) - np.sin(t))

    times = np.linspace(0.0, 5.0, 41)
    solver = integrate(rate, [2.0], 5.0, 1e-12)
    end, states = solver.integrate(5.0, times)
    exact = np.cos(times) + np.exp(-decay * times)
    assert end == pytest.approx(exact[-1], abs=1e-11)
    assert states[:, 0] == pytest.approx(exact, abs=1e-11)
    assert len(solver.step_ends) < 120


def test_oscillation_has_error_within_estimates() -> None:
    """A harmonic oscillator; looser tolerances give larger errors and longer steps."""

    def rate(_: float, y: Array) -> Array:
        return np.array([3.0 * y[1], -3.0 * y[0]])

    counts = []
    for tolerance in (1e-12, 1e-9, 1e-6):
        solver = integrate(rate, [1.0, 0.0], 10.0, tolerance)
        end, _ = solver.integrate(10.0, np.empty(0))
        assert end is not None
        error = np.abs(end - [np.cos(30.0), -np.sin(30.0)]).max()
        assert error < max(sum(solver.lasting), 1e-13)
        assert max(solver.errors) < 2.0 * tolerance
        counts.append(len(solver.step_ends))
    assert counts[0] > 1.5 * counts[1] > 2.0 * counts[2]


def test_nonlinear_equation_converges() -> None:
    """Y' = −y² has the solution 1/(1 + t); a coupled stiff part does not disturb it."""

    def rate(_: float, y: Array) -> Array:
        return np.array([-(y[0] ** 2), -1e5 * (y[1] - y[0] ** 3)])

    solver = integrate(rate, [1.0, 0.0], 4.0, 1e-12)
    times = np.array([0.5, 1.0, 4.0])
    _, states = solver.integrate(4.0, times)
    assert states[:, 0] == pytest.approx(1.0 / (1.0 + times), abs=1e-11)
    # The slaved part follows y₀³ with the lag −(y₀³)'/λ = 3 y₀⁴/λ.
    assert states[:, 1] == pytest.approx((1.0 + times) ** -3 + 3e-5 * (1.0 + times) ** -4, abs=3e-9)


def test_spans_restart_with_changed_equations() -> None:
    """Integration in two spans gives the states at the times of each."""
    rates = {0: 1.0, 1: -1.0}

    def rate(t: float, _: Array) -> Array:
        return np.array([rates[int(t >= 1.0 and now)]])

    now = 0
    solver = integrate(rate, [0.0], 2.0, 1e-10)
    solver.integrate(1.0, np.empty(0))
    now = 1
    end, states = solver.integrate(2.0, np.array([1.5, 2.0]))
    assert end == pytest.approx(0.0, abs=1e-14)
    assert states[:, 0] == pytest.approx([0.5, 0.0], abs=1e-14)


def test_integration_gives_up() -> None:
    """After the allowed evaluations, or where the solution 1/√(1 − t) ends."""

    def rate(_: float, y: Array) -> Array:
        return np.asarray(0.5 * y**3)

    solver = integrate(rate, [1.0], 2.0, 1e-8)
    assert solver.integrate(2.0, np.empty(0))[0] is None
    assert solver.t == pytest.approx(1.0, abs=1e-6)
    solver = integrate(rate, [1.0], 0.5, 1e-8)
    solver.most_evaluations = 50
    assert solver.integrate(0.5, np.empty(0))[0] is None
    assert solver.t < 0.1


def test_round_off_of_stiff_forces_is_accepted_and_reported() -> None:
    """A critically damped spring at 1e5/s has accelerations with a noise of 1e-6."""

    def rate(t: float, y: Array) -> Array:
        stretched = 1e10 * (y[0] - np.cos(t))
        return np.array([y[1], -stretched - 2e5 * y[1]])

    solver = integrate(rate, [1.0, 0.0], 3.0, 1e-13)
    times = np.linspace(0.0, 3.0, 20)
    _, states = solver.integrate(3.0, times)
    assert states[1:, 0] == pytest.approx(np.cos(times[1:] - 2e-5), abs=1e-9)
    assert max(solver.errors) > 1e-13


def test_jacobian_and_spectral_radius_of_linear_equations() -> None:
    """A stiff diagonal, and a matrix that is not finite."""
    matrix = np.array([[0.0, 1.0], [-4e6, -1e3]])
    J = jacobian(lambda _t, y: matrix @ y, 0.0, np.array([0.3, 7.0]), np.array([1.0, 100.0]))
    assert pytest.approx(matrix, rel=1e-6, abs=1e-6) == J
    assert spectral_radius(J) == pytest.approx(2e3, rel=1e-6)
    assert spectral_radius(np.array([[np.nan]])) == np.inf


def test_nodes_are_radau_points() -> None:
    """Weights of the interpolatory formula integrate t^12 exactly, but not t^13."""
    powers = np.vander(NODES, 7, increasing=True).T
    weights = np.linalg.solve(powers, 1.0 / np.arange(1, 8))
    assert weights @ NODES**12 == pytest.approx(1.0 / 13.0, rel=1e-12)
    assert abs(weights @ NODES**13 - 1.0 / 14.0) > 1e-10
