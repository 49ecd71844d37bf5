"""Bounds on the errors of a motion, and errors of the reference solution."""

from __future__ import annotations

import time
from functools import cache
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred.common.arrays import Array
from pinred.forces import Torque
from pinred.judge import compare as judge
from pinred.judge.audit import equation_errors
from pinred.judge.compare import (
    compute_error_bounds,
    count_informative_times,
    explain_rest,
    explain_uninformative_times,
)
from pinred.judge.reference_solution import FullMotion, FullState, Size, Solution
from pinred.judge.step_defects import Defects, reference_errors
from pinred.judge.verdict import Verdict

RTOL, ATOL = 1e-8, 5e-9
TOLERANCE = RTOL + ATOL


@cache
def cat() -> pinred.Trajectory:
    """Simulate the falling cat for one second."""
    return pinred.simulate(pinred.load("falling_cat"), duration=1.0, rtol=RTOL, atol=ATOL)


class Spy:
    """Record the runs of the full simulation, and optionally modify the errors of the reference."""

    def __init__(
        self,
        monkeypatch: pytest.MonkeyPatch,
        *,
        residual: float | None = None,
        apart: float = 0.0,
        at: int = -1,
    ) -> None:
        """Start recording.

        residual: error of the reference by its residuals.  apart: change of the second solution
        [rad].  at: index of the time of both changes.
        """
        self.runs: list[tuple[str, float, float]] = []
        solve = FullState.solve

        def watched(
            full: FullState, y0: Array, times: Array, rtol: float, atol: float, **more: Any
        ) -> Solution:
            result = solve(full, y0, times, rtol, atol, **more)
            self.runs.append((more.get("method", "dop853"), rtol, atol))
            if more.get("method") == "dopri5":
                result.motion.x[at, 0] += apart
            return result

        def changed(*arguments: Any) -> Array:
            errors = reference_errors(*arguments)
            if residual is not None:
                errors[at] = residual
            return errors

        monkeypatch.setattr(FullState, "solve", watched)
        monkeypatch.setattr(judge, "reference_errors", changed)


def test_reference_and_perturbed_run_use_tighter_tolerance(monkeypatch: pytest.MonkeyPatch) -> None:
    """They use a tolerance 100 times tighter; small residuals need no second solution."""
    spy = Spy(monkeypatch)
    began = time.perf_counter()
    report = pinred.compare(cat())
    assert 0.0 < report.wall_full < time.perf_counter() - began
    assert spy.runs[0] == ("dop853", RTOL, ATOL)  # the timed run
    assert [name for name, *_ in spy.runs[1:]] == ["dop853", "dop853"]
    for _, rtol, atol in spy.runs[1:]:
        assert (rtol, atol) == pytest.approx((RTOL / 100.0, ATOL / 100.0))


def test_growth_is_measured_at_1e_10_or_looser(monkeypatch: pytest.MonkeyPatch) -> None:
    """A ten-thousandth of the perturbation is accurate enough, and the atol a hundredth of it."""
    traj = pinred.simulate(cat().system, duration=0.2, rtol=1e-11, atol=1e-11)
    spy = Spy(monkeypatch)
    assert pinred.compare(traj).passed
    assert spy.runs[1][1:] == pytest.approx((1e-13, 1e-13))
    assert spy.runs[2] == ("dop853", 1e-10, 1e-12)


@pytest.mark.parametrize(("part", "count"), [(0.99, 0), (1.01, 1), (np.nan, 1)])
def test_wide_residuals_need_second_solution(
    monkeypatch: pytest.MonkeyPatch, part: float, count: int
) -> None:
    """Beyond ten tolerances times the growth; the second solution has the same tolerance."""
    bound = 10.0 * TOLERANCE * pinred.compare(cat()).growth[50]
    spy = Spy(monkeypatch, residual=part * bound, at=50)
    report = pinred.compare(cat())
    assert spy.runs[3:] == count * [("dopri5", *spy.runs[1][1:])]
    if count == 0:
        assert report.reference_error == pytest.approx(0.99 * bound)
    elif part > 1.0:
        assert report.reference_error < 0.01 * bound
    assert report.passed == (part < 2.0)


def test_smaller_of_residuals_and_difference_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """A difference from the second solution beyond its bound fails, unless residuals are small."""
    most = pinred.compare(cat()).reference_bound
    for residual, apart, error in ((2.0 * most, 1e-7, 1e-7), (0.5 * most, 3.0 * most, 0.5 * most)):
        with monkeypatch.context() as patch:
            Spy(patch, residual=residual, apart=apart)
            report = pinred.compare(cat())
            assert report.reference_error == pytest.approx(error, rel=1e-2)
            assert report.passed
    Spy(monkeypatch, residual=2.0 * most, apart=3.0 * most)
    report = pinred.compare(cat())
    assert report.verdict is Verdict.FAILED
    value, bound = report.checks["reference error [relative]"]
    assert value > bound


def test_error_of_reference_widens_later_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """An error at one time is added to all later bounds."""
    Spy(monkeypatch, residual=2e-6, apart=1e-6, at=50)
    bounds = pinred.compare(cat()).rotation_bounds
    assert bounds[49] < 1e-6
    assert (bounds[50:] > 0.99e-5).all()


def compare_with_defects(
    monkeypatch: pytest.MonkeyPatch,
    steps: float,
    inside: float,
    growth: float | Array,
    traj: pinred.Trajectory | None = None,
    own: float = 1.0,
    blurred: float = 0.0,
) -> pinred.Report:
    """Compare a motion with artificial defects and growth.

    own: ratio of defects in units of the motion.  blurred: round-off of ABA [1/s].
    """
    both = np.full(9, steps), np.full(9, inside)
    defects = Defects(*both, np.ones(9, dtype=bool), own * both[0], own * both[1], blurred)
    monkeypatch.setattr(judge, "compute_defects", lambda *_: defects)
    monkeypatch.setattr(
        FullState, "growth", lambda _full, _y0, _motion, times, *_: growth + np.zeros(len(times))
    )
    return pinred.compare(traj or cat())


@pytest.mark.parametrize(("steps", "mean"), [(2e-8, 2e-8), (1e-4, 3.0 * TOLERANCE)])
def test_drift_bound_grows_with_defects(
    monkeypatch: pytest.MonkeyPatch, steps: float, mean: float
) -> None:
    """The bound is twice the sum of the mean defects, limited to passing defects."""
    fine = pinred.DOP853(max_step=0.01)
    traj = pinred.simulate(cat().system, duration=1.0, rtol=RTOL, atol=ATOL, method=fine)
    count = len(traj.motion.knots) - 1
    assert count >= 100
    report = compare_with_defects(monkeypatch, steps, 0.0, 1.0, traj)
    assert report.drift_bound == pytest.approx(2.0 * count * mean)


def test_compare_uses_101_times_and_report_times() -> None:
    """A motion of almost no duration has round-off only."""
    system = cat().system
    traj = pinred.simulate(system, duration=1.0, times=[0.0, 0.333], rtol=1e-14, atol=1e-16)
    report = pinred.compare(traj)
    assert report.t == pytest.approx(np.union1d(np.linspace(0.0, 1.0, 101), 0.333), abs=1e-15)
    least = 1e-13 + report.growth[0] * 1e-15
    assert report.rotation_bounds[0] == pytest.approx(10.0 * least, abs=0.0)
    assert report.defect_bound == pytest.approx(3.0 * (1e-13 + 1e-16), abs=0.0)


def test_reference_is_judged_only_at_informative_times(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither the reference error nor its bound depends on later times."""
    growth = np.concatenate([np.full(50, 1.0), [7.0], np.full(150, 1e6)])
    Spy(monkeypatch, residual=1.0, apart=1.0, at=51)
    report = compare_with_defects(monkeypatch, 1e-9, 0.0, growth)
    assert report.told == 51
    assert report.reference_bound == pytest.approx(700.0 * TOLERANCE)
    assert report.reference_error < 1e-9
    assert report.verdict is Verdict.CANNOT_TELL
    assert f"can be judged until t = {report.t[50]:g} s only" in report.reasons[0]


@pytest.mark.parametrize(("steps", "most"), [(1e-9, 1e-9), (1e-4, 3.0 * TOLERANCE)])
@pytest.mark.parametrize(("inside", "least"), [(1e-8, 1e-8), (1e-2, 50.0 * TOLERANCE)])
@pytest.mark.parametrize("own", [1.0, 30.0])
@pytest.mark.sampled
def test_error_bound_is_sum_of_defects_times_growth(
    monkeypatch: pytest.MonkeyPatch,
    steps: float,
    most: float,
    inside: float,
    least: float,
    own: float,
) -> None:
    """Failing defects do not loosen the bound; growth applies to defects in units of the motion."""
    report = compare_with_defects(monkeypatch, steps, inside, 7.0, own=own)
    count = np.searchsorted(cat().motion.knots, report.t)
    local = own * (count * most + np.where(count > 0, least, 0.0))
    assert report.rotation_bounds == pytest.approx(
        10.0 * (7.0 * local + 1e-13), rel=0.02, abs=2e-11
    )
    assert report.shape_bounds[:, 0] == pytest.approx(
        report.rotation_bounds
    )  # the least unit is 1 rad


@pytest.mark.parametrize(("kinked", "most"), [(1e-8, 1e-8), (1e-2, 3.0 * TOLERANCE)])
def test_defects_at_kinks_do_not_loosen_the_bound(kinked: float, most: float) -> None:
    """Each step with a kink is limited to the defect that passes; dense output does not count."""
    knots = np.arange(101.0) / 100.0
    traj: Any = SimpleNamespace(motion=SimpleNamespace(knots=knots))
    smooth = np.arange(10) != 4
    steps = np.where(smooth, 1e-12, kinked)
    defects = Defects(steps, 7.0 * steps, smooth, 2.0 * steps, 9.0 * steps, 0.0)
    times, size = np.array([0.0, 1.0]), Size(joints=np.ones(1), position=1.0, away=0.0)
    bounds = compute_error_bounds(
        traj, times, np.array([1.0, 5.0]), defects, np.zeros(2), size, TOLERANCE
    )
    # Ten of a hundred steps are evaluated, and one of the ten has a kink.
    expected = 10.0 * 5.0 * (100 * 2e-12 + 10 * 2.0 * most + 9e-12 + 101e-15)
    assert bounds.relative[1] == pytest.approx(expected, rel=1e-3)
    assert bounds.relative[0] < 2e-12
    assert bounds.total_defect == pytest.approx(100 * 1e-12 + 10 * most, rel=1e-6)


def test_compare_fails_for_order_loss_at_kinks() -> None:
    """AdaptiveGauss misses its tolerance a thousandfold across kinks of |v|; DOP853 does not."""
    system = pinred.load("elroys_beanie")
    damper = Torque(
        lambda s: {"beanie": -0.05 * ca.fabs(s.xdot[0]) - 0.5 * (1.0 + ca.fabs(s.x[0])) * s.x[0]}
    )
    scene = pinred.Scene(system=system, seed=1, forces=damper, duration=2.0, rtol=1e-10, atol=5e-11)
    good = pinred.simulate(scene, method="DOP853")
    with pytest.warns(pinred.AccuracyWarning, match="loses its order"):
        bad = pinred.simulate(scene, method="AdaptiveGauss")
    assert good.run.notices == ()
    assert "kink" in bad.run.notices[0]
    assert np.abs(bad.x - good.x).max() > 1e3 * 1.5e-10
    assert pinred.compare(good).passed, str(pinred.compare(good))
    assert pinred.compare(bad).verdict is Verdict.FAILED


def test_error_bound_includes_round_off_of_aba(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its rate times the duration times the growth is added."""
    report = compare_with_defects(monkeypatch, 0.0, 0.0, 7.0, blurred=1e-7)
    assert report.rotation_bounds == pytest.approx(
        10.0 * 7.0 * 1e-7 * report.t, abs=0.5 * TOLERANCE
    )


def test_compare_of_nearly_singular_body_passes() -> None:
    """Its inertia loses five digits of the rates.

    The reference shares these errors of ABA, so its residuals do not show them.
    """
    model = pin.Model()
    model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "base")
    inertia = pin.Inertia(0.5, np.array([0.2, 0.0, 0.2]), 2e-7 * np.eye(3))
    model.appendBodyToJoint(1, inertia, pin.SE3.Identity())
    traj = pinred.simulate(
        pinred.load(model), duration=0.1, xi0=[-0.1, 1.3, -0.3], rtol=1e-10, atol=1e-11
    )
    spin, arm = -0.3, np.array([0.2, 0.0])
    angle = spin * traj.t
    centre = arm + np.outer(traj.t, [-0.1, 1.3 + spin * 0.2])
    turned = np.column_stack([np.cos(angle), np.sin(angle)]) * 0.2
    assert traj.pose[:, :2] == pytest.approx(centre - turned, abs=1e-10)
    assert traj.pose[:, 2] == pytest.approx(angle, abs=1e-10)
    report = pinred.compare(traj)
    assert report.rotation_errors.max() > 3e-13
    assert report.passed
    assert report.rotation_bounds.max() < 1e-8


@pytest.mark.parametrize(("growth", "verdict"), [(9e4, "PASSED"), (1.1e5, "CANNOT TELL")])
def test_perturbation_that_grows_to_a_tenth_cannot_tell(
    monkeypatch: pytest.MonkeyPatch, growth: float, verdict: str
) -> None:
    """Growth above 1e5 of a perturbation of 1e-6 carries no information."""
    report = compare_with_defects(monkeypatch, 1e-9, 0.0, growth)
    assert report.verdict == verdict
    assert report.told == (len(report.t) if verdict == "PASSED" else 0)
    assert report.reference_bound == 0.1  # limited: 100 tolerances times the growth exceed it


@pytest.mark.parametrize(("allowed", "verdict"), [(0.09, "PASSED"), (0.11, "CANNOT TELL")])
def test_bound_above_a_tenth_cannot_tell(
    monkeypatch: pytest.MonkeyPatch, allowed: float, verdict: str
) -> None:
    """A tenth of a radian, or of the size of the motion."""
    growth = allowed / (10.0 * 50.0 * TOLERANCE)
    report = compare_with_defects(monkeypatch, 0.0, 1.0, growth)
    assert report.verdict == verdict


@pytest.mark.parametrize(("growth", "told", "why"), [
    (2e5, 0, "a small change of the initial state has grown 2.0e+05 times by the end"),
    (0.15 / (500.0 * TOLERANCE), 2, "errors up to 1.5e-01 would pass by the end"),
])  # fmt: skip
def test_reason_names_chaos_or_wide_bounds(
    monkeypatch: pytest.MonkeyPatch, growth: float, told: int, why: str
) -> None:
    """The reason distinguishes chaos from a loose tolerance."""
    report = compare_with_defects(monkeypatch, 0.0, 1.0, growth)
    assert report.told <= told
    assert why in report.reasons[0]
    assert "until t = 0 s only" in report.reasons[0]


def test_error_bound_without_defects_is_round_off() -> None:
    """Round-off of steps, of ABA and of the references remains.

    Growth multiplies that of steps and of ABA; a distant base adds the round-off of its position.
    """
    knots = np.arange(1025.0) / 1024.0
    traj: Any = SimpleNamespace(motion=SimpleNamespace(knots=knots))
    times, steps = np.array([0.0, 0.25, 0.5 + 1e-9, 1.0]), np.array([0, 256, 513, 1024])
    growth, between = np.array([1.0, 2.0, 3.0, 50.0]), np.array([0.0, 4e-13, 1e-13, 2e-13])
    none = np.zeros(3)
    defects = Defects(none, none, np.ones(3, dtype=bool), none, none, 3e-13)
    size = Size(joints=np.array([2.0, 5.0]), position=3.0, away=7e3)
    bounds = compute_error_bounds(traj, times, growth, defects, between, size, TOLERANCE)
    differences = np.array([0.0, 4e-13, 4e-13, 4e-13])
    expected = 10.0 * (growth * (1e-15 * (steps + 1) + 3e-13 * times) + 1e-13 + differences)
    assert bounds.distance.rotation == pytest.approx(expected, rel=1e-9, abs=0.0)
    assert bounds.distance.joints == pytest.approx(
        np.outer(expected, [2.0, 5.0]), rel=1e-9, abs=0.0
    )
    assert bounds.distance.position == pytest.approx(3.0 * expected + 7e-11, rel=1e-9, abs=0.0)
    assert bounds.relative == pytest.approx(expected, rel=1e-9, abs=0.0)
    assert bounds.total_defect == 0.0
    assert count_informative_times(bounds.relative, growth) == 4
    assert explain_uninformative_times(times, 4, bounds.relative, growth) == ()


def test_equations_are_compared_over_whole_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    """At 101 evenly spaced times."""
    seen: list[Array] = []
    expected = equation_errors

    def watched(traj: pinred.Trajectory, full: FullState, times: Array) -> Array:
        seen.append(times)
        return expected(traj, full, times)

    monkeypatch.setattr(judge, "equation_errors", watched)
    parts: list[float] = []
    pinred.compare(cat(), progress=parts.append)
    assert seen[0].tolist() == np.linspace(0.0, 1.0, 101).tolist()
    assert parts == [0.1, 0.3, 0.5, 0.8, 0.9, 1.0]


@pytest.mark.parametrize(("part", "rests"), [(0.3, True), (3.0, False)])
@pytest.mark.parametrize("kind", ["place", "far place", "joint", "slide", "ball"])
def test_motion_below_1e_12_counts_as_rest(kind: str, part: float, rests: bool) -> None:
    """Relative to a metre or the distance travelled, a radian, and the unit of prismatic joints.

    With balls, q alone is compared: x has four numbers for three units.
    """
    x, q = np.zeros((2, 4 if kind == "ball" else 2)), np.zeros((2, 9))
    x[1, :2] = part * 1e-12 * np.array([kind == "joint", 7.0 * (kind == "slide")])
    q[1, 0] = part * 1e-12 * {"place": 1.0, "far place": 50.0, "ball": 1.0}.get(kind, 0.0)
    units = np.ones(3) if kind == "ball" else np.array([1.0, 7.0])
    size = Size(units, position=50.0 if kind == "far place" else 0.2, away=0.0)
    assert bool(explain_rest(FullMotion(x=x, q=q), size)) is rests
