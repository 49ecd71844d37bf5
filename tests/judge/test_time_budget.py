"""A comparison ends within its time budget, with the verdict CANNOT TELL."""

from __future__ import annotations

import time
from functools import partial
from itertools import count

import numpy as np
import pytest
from tampering import offset, tampered

import pinred
from pinred.judge.compare import _compare
from pinred.judge.reference_integrators import (
    AbaStopped,
    Hairer,
    StiffIntegrator,
    TimeBudget,
    default_budget,
)
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
