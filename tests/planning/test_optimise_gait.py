"""Tests of gait optimisation against published values, ABA, RNEA and differences."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from assertions import close
from inverse_dynamics import joint_torques
from lifts import by_pinocchio
from scipy.optimize import nnls
from three_links import CENTRES, LENGTH, LINKS

import pinred
from pinred.analysis.phases.lift import fourier_rows, path_lift
from pinred.common.arrays import Array
from pinred.planning.optimisation import gait_search, nonlinear_program, optimise
from pinred.planning.optimisation.gait_search import (
    TargetMissed,
    Task,
    finish,
    fourier_path_of,
    loop_to_target,
    problem_of,
)
from pinred.planning.optimisation.limits import (
    LimitChecks,
    LimitedLoop,
    Limits,
    Times,
    first_checks,
    limits_of,
)
from pinred.planning.optimisation.nonlinear_program import (
    Minimum,
    Problem,
    kkt_residual,
    minimum,
    sharpened,
)
from pinred.planning.optimisation.objective import COSTS, axis_aim, target_aim

FEW = 2300  # evaluations, of about 1600 with both safeguards and at least 2900 without one
TURN = 0.033787199534  # rotation of three rods by half of the square |α| ≤ 1 [rad]
RODS = {name: pinred.Rod(LENGTH, 2.0, 1.0, centre=(CENTRES[name], 0.0, 0.0)) for name in LINKS}


def swimmer() -> pinred.Connection:
    """Return the connection of Purcell's swimmer with drag ratio 2."""
    return pinred.Connection.viscous(pinred.load("purcell_swimmer"), RODS)


def rods() -> pinred.Connection:
    """Return the mechanical connection of three equal rods."""
    return pinred.Connection.mechanical(pinred.load("three_rods"))


@pytest.mark.by_hand
def test_optimal_stroke_of_purcells_swimmer_exceeds_published_one() -> None:
    """Displacement per metric length, above the published 0.11094879."""
    best = pinred.optimise_gait(swimmer(), objective="displacement", harmonics=5, starts=5)
    first = best.optima[0]
    assert first.found >= 3  # of 5; large perturbations lead two starts elsewhere
    assert 0.11119 < best.merit < 0.1112
    assert abs(first.winding or 0.0) == 1.0
    assert first.residual < 1e-5
    assert abs(first.phase.pose[2]) < 1e-8  # it swims straight
    assert best.merit == pytest.approx(first.phase.pose[0] / first.phase.length, rel=1e-12)


@pytest.mark.by_hand
def test_optimal_rotation_of_three_rods() -> None:
    """Rotation per metric length, also by SciPy with Pinocchio's mass matrix."""
    best = pinred.optimise_gait(rods(), objective="rotation", harmonics=9, starts=1)
    assert best.merit == pytest.approx(2.38599, abs=6e-6)
    assert abs(best.winding or 0.0) == 1.0
    system = pinred.load("three_rods")
    pose = by_pinocchio(system, best.gait, np.zeros(3))
    red = pinred.Reduction(system)
    x, xdot = best.gait.samples(400)
    speeds = [np.sqrt(v @ red.reduced_metric(y) @ v) for y, v in zip(x, xdot, strict=True)]
    assert pose[2] / (best.gait.period * np.mean(speeds)) == pytest.approx(best.merit, rel=1e-9)


@pytest.mark.by_hand
def test_optimal_polygon_reaches_largest_rotation() -> None:
    """All starts reach half of the square's rotation, the maximum of simple loops."""
    best = pinred.optimise_gait(rods(), cost=None, vertices=24, limits=1.0, starts=3)
    assert best.optima[0].found == 3
    for each in best.optima:
        assert 0.9999 * TURN <= each.value <= TURN
        assert abs(each.winding or 0.0) == 1.0
        assert each.margins["limits"] >= 0.0


@pytest.mark.by_hand
def test_best_gait_certificate_agrees_with_aba_and_rnea() -> None:
    """Full ABA under its torques, torques by RNEA, and limits between the nodes."""
    torque, speed = 0.1, 3.0
    best = pinred.optimise_gait(
        rods(), cost="time", limits={"alpha1": 1.0, "alpha2": (-0.8, 1.0)}, speeds=speed,
        torques={"alpha1": torque}, harmonics=3, starts=1,
    )  # fmt: skip
    assert best.report.passed
    assert best.flow_error.rotation < 1e-8
    assert best.flow_error.translation < 1e-8
    t = np.linspace(0.0, best.gait.period, 2001)
    x, xdot = best.gait.at(t)
    assert np.abs(x).max() <= 1.0
    assert x[:, 1].min() >= -0.8
    assert np.abs(xdot).max() <= speed
    step = 1e-4
    bend = (best.gait.at(t + step)[1] - best.gait.at(t - step)[1]) / (2.0 * step)
    system = pinred.load("three_rods")
    tau = np.array([joint_torques(system, *each) for each in zip(x, xdot, bend, strict=True)])
    assert 0.99 * torque < np.abs(tau[:, 0]).max() <= torque * (1.0 + 1e-6)
    driving = best.trajectory.driving_torques
    assert np.abs(driving[:, 0]).max() == pytest.approx(np.abs(tau[:, 0]).max(), rel=1e-2)
    for name, size in (("limits", 1e-2), ("speeds", 3.0), ("torques", 1e-3)):
        assert 0.0 <= best.optima[0].margins[name] <= size
    assert "verdict" not in str(best)
    assert re.search(r"time \[s\] +\S+ +T, the period", str(best))


@pytest.mark.by_hand
def test_limits_hold_between_sample_times(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without checks at the peaks the limits are violated."""
    best = pinred.optimise_gait(rods(), cost="power", limits=1.0, harmonics=3, starts=1)
    assert np.abs(best.gait.limits).max() <= 1.0
    monkeypatch.setattr(LimitedLoop, "peaks_beyond", no_peaks)
    monkeypatch.setattr(optimise, "margins", lambda *_: {"limits": 0.0})
    loose = pinred.optimise_gait(rods(), cost="power", limits=1.0, harmonics=3, starts=1)
    assert np.abs(loose.gait.limits).max() > 1.0001


def no_peaks(*_: Any) -> Times:
    """Return no peaks beyond limits."""
    return Times(*np.zeros((4, 0)))


def test_loop_beyond_its_limits_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    """The exact margins of the loop are checked at the end, independently of the search."""
    monkeypatch.setattr(LimitedLoop, "peaks_beyond", no_peaks)
    with pytest.raises(pinred.NoOptimum, match="exceeds its limits"):
        pinred.optimise_gait(rods(), cost="power", limits=1.0, harmonics=1, starts=1)


@pytest.mark.parametrize("options", [{"harmonics": 1}, {"vertices": 8, "cost": None}])
def test_limits_are_not_exceeded_by_round_off(options: dict[str, Any]) -> None:
    """Loops and polygons end at a small distance inside their active limits."""
    limits: dict[str, Any] = {"alpha1": 0.7, "alpha2": (-0.3, 0.9)}
    best = pinred.optimise_gait(rods(), **options, limits=limits, starts=1)
    assert 0.0 < best.margins["limits"] < 2e-8


def test_optimum_within_limits_satisfies_kkt_conditions_of_ellipses() -> None:
    """An ellipse has extremes mean ± √(cos² + sin²): its KKT conditions have a closed form.

    Times of peaks are known to 3e-7 of the period only, because values near a peak differ by the
    square of the distance.  The normals of the limits have errors of 2π times that.
    """
    A = rods()
    best = pinred.optimise_gait(A, harmonics=1, limits=1.0, starts=1)
    assert best.merit >= 0.10327495
    arc = best.gait.series
    mean, cos, sin = arc.mean, arc.cos[0], arc.sin[0]
    radius, p = np.hypot(cos, sin), pinred.phase_slopes(A, best.gait)
    extremes = np.abs(mean) + radius
    assert (extremes <= 1.0).all()
    close(extremes, np.ones(2), 2e-8)
    slope = p.twist[2] / p.length - p.pose[2] * p.length_slope / p.length**2
    normals = np.zeros((2, 3, 2))
    for j in range(2):
        normals[j, :, j] = np.sign(mean[j]), cos[j] / radius[j], sin[j] / radius[j]
    sign = np.sign(p.pose[2])
    multipliers, residual = nnls(normals.reshape(2, -1).T, sign * slope.ravel())
    assert (multipliers > 0.01).all()
    assert residual < 3e-6 * best.merit


def test_limits_at_first_checks_alone_are_exceeded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rounds with checks at the peaks are needed; one round alone raises NoOptimum."""
    monkeypatch.setattr(gait_search, "_ROUNDS", 1)
    with pytest.raises(pinred.NoOptimum, match="exceeds its limits"):
        pinred.optimise_gait(rods(), harmonics=1, limits=1.0, starts=1)


def test_perturbation_leaves_a_symmetric_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a perturbation the search ends at a stationary loop with a smaller merit."""
    options = {"harmonics": 4, "limits": 0.7, "starts": 1}
    best = pinred.optimise_gait(rods(), **options)  # type: ignore[arg-type]
    assert best.merit == pytest.approx(0.05579261, rel=1e-6)
    monkeypatch.setattr(optimise, "_PERTURBATIONS", (0.0,))
    assert pinred.optimise_gait(rods(), **options).merit < 0.05575  # type: ignore[arg-type]


def test_checks_move_with_a_shifted_loop() -> None:
    """A loop keeps the values of its checks if it is shifted along itself, to second order."""
    A, c = rods(), np.random.default_rng(2).uniform(-0.5, 0.5, (5, 2))
    limits = limits_of(A, 1.0, 3.0, 0.3)
    nothing = Times(*np.zeros((4, 0)))
    checks = first_checks(limits, 2).refined(nothing, c)
    k = 2.0 * np.pi * np.arange(1, 3)[:, None]
    cos, sin = c[1:3], c[3:]
    before = LimitedLoop(A, limits, c, 1.3).values(checks).values
    for shift, error in ((1e-3, 2e-4), (1e-4, 2e-6)):
        C, S = np.cos(k * shift), np.sin(k * shift)
        shifted = np.vstack([c[:1], C * cos + S * sin, C * sin - S * cos])
        assert checks.shift(shifted) == pytest.approx(-shift, rel=1e-4)
        close(LimitedLoop(A, limits, shifted, 1.3).values(checks).values, before, error)


def test_refined_checks_divide_the_time_around_a_peak() -> None:
    """Checks follow at the peak and towards its neighbours, and others stay."""
    limits, c = limits_of(rods(), 1.0, None, None), np.eye(3, 2)
    checks = first_checks(limits, 1)
    peak = Times(np.array([0]), np.array([1]), np.array([-1.0]), np.array([0.99]))
    finer = checks.refined(peak, c).times
    same = (finer.joint == 1) & (finer.sign == -1.0)
    coarse = np.sort(checks.times.s[(checks.times.joint == 1) & (checks.times.sign == -1.0)])
    added = np.setdiff1d(np.round(finer.s[same], 12), np.round(coarse, 12))
    before, after = 0.99 - coarse[-1], 1.0 - 0.99
    parts = np.array([0.5, 0.125, 0.03125])
    expected = np.concatenate([0.99 - before * parts, [0.99], 0.99 + after * parts[::-1]])
    close(added, expected, 1e-12)
    assert same.sum() == len(coarse) + 7
    assert len(finer.s) == len(checks.times.s) + 7


@pytest.mark.by_hand
def test_shortest_turn_of_falling_cat_by_180_degrees() -> None:
    """The length without limits at 16 harmonics: at most 0.5773."""
    A = pinred.Connection.mechanical(pinred.load("falling_cat"))
    best = pinred.optimise_gait(
        A, objective="target", target=[np.pi, 0.0, 0.0], limits=10.0, harmonics=16, starts=1, seed=1
    )
    assert best.cost <= 0.5773
    assert best.value < 1e-6
    turned = by_pinocchio(pinred.load("falling_cat"), best.gait, np.zeros(6))
    close(np.abs(turned[3:]), [1.0, 0.0, 0.0, 0.0], 1e-6)


@pytest.mark.by_hand
def test_least_torque_that_pitches_solo12_by_30_degrees() -> None:
    """√∫Σ τ² dt is at most 0.153, with torques by RNEA and the attitude by Pinocchio."""
    system = pinred.load("solo12")
    pitch = np.radians(30.0)
    best = pinred.optimise_gait(
        pinred.Connection.mechanical(system), objective="target", target=[0.0, pitch, 0.0],
        cost="torque", limits=1.0, harmonics=5, starts=1,
    )  # fmt: skip
    assert np.sqrt(best.cost) <= 0.153
    assert np.abs(best.gait.limits).max() <= 1.0
    arc = best.gait.series
    rate = 2.0 * np.pi * np.arange(1, 6)
    t = np.arange(50) / 50.0
    bend = -(rate**2 * np.cos(np.outer(t, rate))) @ arc.cos
    bend -= (rate**2 * np.sin(np.outer(t, rate))) @ arc.sin
    states = zip(*best.gait.at(t), bend, strict=True)
    tau = np.array([joint_torques(system, *state) for state in states])
    assert np.mean((tau**2).sum(axis=1)) == pytest.approx(best.cost, rel=1e-6)
    turned = by_pinocchio(system, best.gait, np.zeros(6))
    close(turned[3:], [0.0, np.sin(0.5 * pitch), 0.0, np.cos(0.5 * pitch)], 1e-8)


def test_peaks_beyond_limits_are_those_of_a_fine_grid() -> None:
    """Times of the maxima of shapes, speeds and torques beyond their limits, torques by RNEA."""
    A, T, system = rods(), 1.3, pinred.load("three_rods")
    limits = limits_of(A, [(-0.5, 1.0), (-1.0, 1.0)], 2.0, 0.3)
    c = np.random.default_rng(5).uniform(-0.5, 0.5, (5, 2))
    found = LimitedLoop(A, limits, c, T).peaks_beyond()
    s = np.arange(1000) / 1000.0
    x, rate, bend = (row @ c for row in fourier_rows(2, s))
    states = zip(x, rate / T, bend / T**2, strict=True)
    tau = np.array([joint_torques(system, *state) for state in states])
    scaled = np.stack([(x - limits.middle) / limits.reach, rate / T / 2.0, tau / 0.3])
    size = np.abs(scaled)
    top = (size > 1.0) & (size >= np.roll(size, 1, 1)) & (size >= np.roll(size, -1, 1))
    kind, time, joint = np.nonzero(top)
    expected = sorted(zip(kind, joint, np.sign(scaled[top]), s[time], strict=True))
    assert set(kind) == {0, 1, 2}
    close(np.array(sorted(zip(*found, strict=True))), np.array(expected), 2.0 / 4000.0)


def test_target_is_reached_at_minimal_torque() -> None:
    """A rotation of 30°; a doubled period needs a quarter of the torque."""
    target = np.radians(30.0)
    options = {"objective": "target", "target": target, "cost": "torque", "limits": 3.0}
    one, two = (
        pinred.optimise_gait(rods(), **options, harmonics=1, starts=1, period=T) for T in (1.0, 2.0)
    )
    assert one.phase.pose[2] == pytest.approx(target, abs=1e-9)
    assert one.cost == pytest.approx(8.0 * two.cost, rel=1e-5)  # ∫τ² dt goes with T⁻³
    assert one.value < 1e-9


def test_target_out_of_reach_is_named_with_its_deviation() -> None:
    """The nearest loop is the one of largest rotation, found by the search without a cost."""
    limits, target = 0.5, 2.0
    most = pinred.optimise_gait(rods(), cost=None, limits=limits, harmonics=1, starts=1).value
    with pytest.raises(pinred.NoOptimum, match="reaches it within the limits") as raised:
        pinred.optimise_gait(
            rods(), objective="target", target=target, limits=limits, harmonics=1, starts=2
        )
    deviation = re.search(r"deviates by ([0-9.]+)\.", str(raised.value))
    assert deviation is not None
    # Checks at fixed times let the extremes between them exceed the limits.
    assert float(deviation[1]) == pytest.approx(target - most, abs=0.1 * most)


def test_functions_are_undefined_without_a_positive_period() -> None:
    """A step of the period to zero or below gives NaN and no division by zero."""
    A = rods()
    limits = limits_of(A, 1.0, 3.0, None)
    task = Task(A, axis_aim(A.group, "rotation", None), "time", None, limits, 1.0)
    problem = problem_of(task, fourier_path_of(task, 1))
    for period in (0.0, -1.0):
        assert np.isnan(problem.evaluate(np.append(np.full(6, 0.1), period))[0]).all()


def test_search_without_feasible_points_ends_after_three_runs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """No point satisfies 0.1 + (z − 1)² = 0; smaller boxes do not help."""
    run, calls = nonlinear_program._run, []

    def counted(*args: Any, **options: Any) -> Any:
        calls.append(args)
        return run(*args, **options)

    def evaluate(z: Array) -> tuple[Array, Array]:
        x = z[0] - 1.0
        return np.array([0.01 * x, 0.1 + x * x]), np.array([[0.01], [2.0 * x]])

    monkeypatch.setattr(nonlinear_program, "_run", counted)
    problem = Problem(1, evaluate, np.zeros((0, 1)), np.zeros(1), np.zeros(1))
    assert minimum(problem, np.zeros(1)).residual == np.inf
    assert len(calls) <= 4


def unconstrained(evaluate: Callable[[Array], tuple[Array, Array]], size: int) -> Problem:
    """Return the problem of minimising a function of `size` unknowns."""
    return Problem(size, evaluate, np.zeros((0, size)), np.zeros(0), np.zeros(0))


def valley(z: Array, steepness: float = 1e5) -> tuple[Array, Array]:
    """Return 1 + (1 − x)² + steepness (y − x²)², whose least value is 1 at (1, 1)."""
    x, y = z
    d = y - x * x
    value = 1.0 + (1.0 - x) ** 2 + steepness * d * d
    by_x = 2.0 * (x - 1.0) - 4.0 * steepness * d * x
    return np.array([value]), np.array([[by_x, 2.0 * steepness * d]])


def test_runs_are_repeated_until_they_gain_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """One run of SLSQP does not reach the end of a bent valley."""
    start = np.array([-1.2, 1.0])
    assert minimum(unconstrained(valley, 2), start).value < 1.0 + 1e-6
    monkeypatch.setattr(nonlinear_program, "_RUNS", 1)
    assert minimum(unconstrained(valley, 2), start).value > 1.0 + 1e-3


def test_newton_runs_sharpen_a_minimum() -> None:
    """Runs that begin with the Hessian reduce the residual; its inverse scales their unknowns."""
    problem = unconstrained(partial(valley, steepness=1e3), 2)
    z = np.array([1.001, 1.002])
    rough = Minimum(z, float(problem.at(z)[0][0]), "", 0, kkt_residual(problem, z))
    assert rough.residual > 1e-3
    assert sharpened(problem, rough).residual < 1e-6
    U = nonlinear_program._newton_units(problem, np.ones(2))
    close(U.T @ np.array([[2.0 + 8e3, -4e3], [-4e3, 2e3]]) @ U, np.eye(2), 0.1)


def test_line_searches_retreat_from_undefined_values(monkeypatch: pytest.MonkeyPatch) -> None:
    """The function −log(1 − z) − 3z is undefined from z = 1 on, where a step from −9 leads."""

    def evaluate(z: Array) -> tuple[Array, Array]:
        if z[0] >= 1.0:
            return np.array([np.nan]), np.array([[np.nan]])
        value, slope = -np.log(1.0 - z[0]) - 3.0 * z[0], 1.0 / (1.0 - z[0]) - 3.0
        return np.array([value]), np.array([[slope]])

    assert minimum(unconstrained(evaluate, 1), np.array([0.5])).z == pytest.approx(2 / 3, abs=1e-5)
    monkeypatch.setattr(nonlinear_program, "_UNDEFINED", -1e10)
    lost = minimum(unconstrained(evaluate, 1), np.array([0.5]))
    assert not abs(float(lost.z[0]) - 2.0 / 3.0) < 1e-5


def test_curved_equations_allow_long_steps() -> None:
    """Without multipliers, line searches along a circle accept short steps alone (Maratos)."""
    count = [0]

    def evaluate(z: Array) -> tuple[Array, Array]:
        count[0] += 1
        c = z @ z - 1.0
        return (
            np.array([10.0 + 50.0 * c - z[0], c]),
            np.array([100.0 * z - [1.0, 0.0], 2.0 * z]),
        )  # fmt: skip

    problem = Problem(2, evaluate, np.zeros((0, 2)), np.zeros(1), np.zeros(1))
    best = minimum(problem, np.array([np.cos(2.0), np.sin(2.0)]))
    close(best.z, [1.0, 0.0], 1e-5)
    assert count[0] < 120  # 61; without the products of multipliers and equations 3780


def _without(name: str) -> Any:
    """Return a case of the name of a safeguard, run by hand."""
    return pytest.param(name, marks=pytest.mark.by_hand)


@pytest.mark.parametrize("removed", ["", _without("_gains"), _without("_newton_units")])
def test_targets_in_space_take_few_evaluations(
    removed: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Runs continue from better points beyond an equation, and begin with the Hessian if slow."""
    count, lift = [0], path_lift
    if removed:
        monkeypatch.setattr(nonlinear_program, removed, lambda *_: None)

    def counted(*arguments: Any) -> Any:
        count[0] += 1
        return lift(*arguments)

    monkeypatch.setattr(gait_search, "path_lift", counted)
    cat, target = pinred.load("falling_cat"), [0.05 * 0.9**3, 0.0, 0.0]
    best = pinred.optimise_gait(
        pinred.Connection.mechanical(cat), objective="target", target=target, limits=0.9,
        harmonics=2, starts=4,
    )  # fmt: skip
    assert best.cost == pytest.approx(0.05260171438, rel=1e-6)
    assert (count[0] < FEW) == (not removed)


def test_undefined_points_are_no_gain() -> None:
    """A point whose values or derivatives are not finite is not accepted."""

    def evaluate(z: Array) -> tuple[Array, Array]:
        log = np.log(z[0]) if z[0] > 0.0 else np.nan
        return np.array([2.0 + log, 0.0]), np.array([[1.0 / z[0]], [0.0]])

    problem = Problem(1, evaluate, np.zeros((0, 1)), np.zeros(1), np.zeros(1))
    assert nonlinear_program._gains(problem, np.ones(1), np.full(1, 0.5))
    assert not nonlinear_program._gains(problem, np.ones(1), np.full(1, -1.0))


def test_search_with_torque_limits_begins_in_a_small_box(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first box is 0.1 wide with limits of torque, and infinite without."""
    A, radii = rods(), []

    def minimum(_: Problem, start: Array, **options: Any) -> Minimum:
        radii.append(options["radius"])
        return Minimum(start, 0.0, "", 0, 0.0)

    monkeypatch.setattr(gait_search, "minimum", minimum)
    gait = pinred.Gait.fourier([0.0, 0.0], [[0.3, 0.0]], [[0.0, 0.3]])
    for torque in (None, 0.1):
        limits = limits_of(A, 1.0, None, torque)
        task = Task(A, axis_aim(A.group, "rotation", None), "length", None, limits, 1.0)
        gait_search.Search(task, fourier_path_of(task, 1)).optimise_from(gait)
    assert radii == [np.inf, 0.1]


def test_target_is_missed_by_more_than_a_tenth_of_a_milliradian() -> None:
    """Targets beyond the largest rotation by 5e-4 are missed; those by 5e-5 count as reached."""
    A, gait = rods(), pinred.Gait.fourier([0.0, 0.0], [[0.3, 0.0]], [[0.0, 0.3]])

    def reach(target: float) -> pinred.Gait:
        limits = limits_of(A, 0.5, None, None)
        task = Task(A, target_aim(A.group, target), "length", None, limits, 1.0)
        return loop_to_target(task, fourier_path_of(task, 1), gait)

    with pytest.raises(TargetMissed) as raised:
        reach(-1.0)
    most = raised.value.deviation - 1.0
    reach(most - 5e-5)
    with pytest.raises(TargetMissed):
        reach(most - 5e-4)


def test_searches_end_at_known_optima_of_equal_objective() -> None:
    """A search from the same gait ends at the known optimum, unless objectives differ by 1e-7."""
    A, gait = rods(), pinred.Gait.fourier([0.0, 0.0], [[0.3, 0.0]], [[0.0, 0.3]])
    limits = limits_of(A, 1.0, None, None)
    task = Task(A, axis_aim(A.group, "rotation", None), "length", None, limits, 1.0)
    search = gait_search.Search(task, fourier_path_of(task, 1))
    end = finish(search, gait)
    assert finish(search, gait, known=[end]) is end
    other = replace(end, objectives=tuple(1.0000001 * value for value in end.objectives))
    again = finish(search, gait, known=[other])
    assert again is not other
    assert again.best.value == pytest.approx(end.best.value, rel=1e-9)


def test_search_without_loops_within_limits_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    """A round whose result violates a constraint ends the start."""
    lost = Minimum(np.zeros(6), 1.0, "no progress", 0, np.inf)
    monkeypatch.setattr(gait_search, "minimum", lambda *_, **__: lost)
    with pytest.raises(pinred.NoOptimum, match=r"no loop within the limits .*no progress"):
        pinred.optimise_gait(rods(), harmonics=1, limits=1.0, starts=1)


# Perturbations and known optima have tests of their own.
@pytest.mark.by_hand
def test_further_starts_reach_an_optimum_that_the_first_misses() -> None:
    """Large perturbations leave the optimum to which the continuation from ellipses leads."""
    options = {"axis": "y", "limits": 1.3, "harmonics": 2}
    cat = pinred.Connection.mechanical(pinred.load("falling_cat"))
    first = pinred.optimise_gait(cat, **options, starts=1)  # type: ignore[arg-type]
    assert pinred.optimise_gait(cat, **options, starts=4).merit > 1.003 * first.merit  # type: ignore[arg-type]


def test_bound_on_cost_is_used_and_result_beats_random_loops() -> None:
    """The bound is active, and random loops of this length rotate less."""
    best = pinred.optimise_gait(rods(), most=0.2, harmonics=1, starts=1)
    assert 0.2 - 4e-9 < best.cost < 0.2
    rng, A = np.random.default_rng(0), rods()
    for _ in range(20):
        mean, cos, sin = rng.uniform(-1.5, 1.5, (3, 2))
        gait = pinred.Gait.fourier(mean, [cos], [sin])
        p = pinred.phase(A, gait.scaled(0.2 / pinred.phase(A, gait).length))
        if p.length <= 0.2:
            assert abs(p.pose[2]) < best.value


def _moving_checks(limits: Limits, rng: np.random.Generator) -> LimitChecks:
    """Return checks that move with a random loop of two harmonics."""
    return first_checks(limits, 2).refined(Times(*np.zeros((4, 0))), rng.normal(size=(5, 2)))


@pytest.mark.parametrize("exact", [False, True])
@pytest.mark.parametrize("cost", COSTS)
@pytest.mark.sampled
def test_transcription_derivatives_equal_differences(cost: str, *, exact: bool) -> None:
    """Derivatives of the objective and all constraints, by differences of order 4."""
    for A in (rods(), swimmer()):
        limits = limits_of(A, 1.0, 2.0, 0.3)
        bound = axis_aim(A.group, "displacement", "x")
        for aim, most in (
            (bound, None),
            (bound, 1.0),
            (target_aim(A.group, [0.1, 0.2, 0.3]), None),
        ):
            task = Task(A, aim, cost, most, limits, 1.3)  # type: ignore[arg-type]
            path = fourier_path_of(task, 2, action=True)
            rng = np.random.default_rng(3)
            if exact:
                path = replace(path, action=False, checks=_moving_checks(limits, rng))
            problem = problem_of(task, path)
            z = np.append(rng.uniform(-0.5, 0.5, path.size), 1.3)[: problem.size]
            along_z, step = rng.normal(size=problem.size), 1e-4 if exact else 1e-3
            expected = sum(
                weight * problem.evaluate(z + k * step * along_z)[0] / (12.0 * step)
                for k, weight in ((1, 8.0), (-1, -8.0), (2, -1.0), (-2, 1.0))
            )
            found = problem.evaluate(z)[1] @ along_z
            size = 1.0 + np.abs(expected)
            close(found / size, expected / size, 1e-8)


def test_costs_equal_rnea_and_pinocchio_metric() -> None:
    """Costs of an ellipse, with torques by RNEA and the metric by Pinocchio."""
    A, system = rods(), pinred.load("three_rods")
    red, T = pinred.Reduction(system), 1.7
    gait = pinred.Gait.fourier([0.2, -0.1], [[0.5, 0.1]], [[-0.2, 0.6]], period=T)
    x, xdot = gait.samples(200)
    bend = -((2.0 * np.pi / T) ** 2) * (x - gait.centre)
    tau = np.array([joint_torques(system, *each) for each in zip(x, xdot, bend, strict=True)])
    M = [red.reduced_metric(each) for each in x]
    expected = {
        "length": T * np.mean([np.sqrt(v @ m @ v) for v, m in zip(xdot, M, strict=True)]),
        "torque": T * np.mean(np.sum(tau**2, axis=1)),
        "power": T * np.mean(np.sum((tau * xdot) ** 2, axis=1)),
        "acceleration": T
        * np.mean([f @ np.linalg.solve(m, f) for f, m in zip(tau, M, strict=True)]),
    }
    c = np.array([[0.2, -0.1], [0.5, 0.1], [-0.2, 0.6]])
    for cost, value in expected.items():
        task = Task(A, target_aim(A.group, 0.1), cost, None, limits_of(A, 3.0, None, None), T)  # type: ignore[arg-type]
        path = fourier_path_of(task, 1, action=True)
        root = problem_of(task, path).evaluate(path.unknowns(c))[0][0] ** 0.25
        power = {"length": 1, "torque": 2, "power": 4, "acceleration": 2}[cost]
        if cost == "length":  # replaced by the action, which is never smaller
            assert root >= value
            assert root == pytest.approx(value, rel=0.2)
        else:
            assert root**power == pytest.approx(value, rel=1e-9)


def test_kkt_residual_is_zero_at_optima_alone() -> None:
    """Interior and bounded optima have zero residual; wrong multiplier signs do not."""

    def parabola(z: Array) -> tuple[Array, Array]:
        return np.array([1.0 + (z[0] - 2.0) ** 2]), np.array([[2.0 * (z[0] - 2.0)]])

    def problem(lower: float, upper: float) -> Problem:
        return Problem(1, parabola, np.eye(1), np.array([lower]), np.array([upper]))

    assert kkt_residual(problem(-9.0, 9.0), np.array([2.0])) == 0.0
    assert kkt_residual(problem(-9.0, 1.0), np.array([1.0])) < 1e-12
    assert kkt_residual(problem(1.0, 9.0), np.array([1.0])) == pytest.approx(1.0)
    assert kkt_residual(problem(-9.0, 9.0), np.array([1.0])) == pytest.approx(1.0)
    assert minimum(problem(-9.0, 1.0), np.zeros(1)).z == pytest.approx(1.0, abs=1e-6)
    assert kkt_residual(problem(-9.0, 1.0), np.array([1.0 + 2e-8])) == np.inf  # beyond its bound


def test_wrong_winding_number_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    """The winding number is checked at the end, independently of the continuation."""
    monkeypatch.setattr(pinred.Gait, "winding", lambda *_, **_centre: 3.0)
    with pytest.raises(pinred.NoOptimum, match="winding number 3"):
        pinred.optimise_gait(rods(), harmonics=1, starts=1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"objective": "spin"}, "objective must be one of rotation, displacement, target"),
        ({"cost": "love"}, "unknown cost 'love'; the costs are length"),
        ({"winding": 2}, "winding must be 1, or None"),
        ({"winding": None, "cost": None}, "winding=None needs a cost"),
        ({"objective": "target"}, "objective 'target' requires target="),
        ({"cost": "time"}, "needs limits of speeds or torques"),
        ({"most": 1.0, "cost": None}, "most= bounds a cost"),
        ({"limits": {"alpha3": 1.0}}, "no shape joint 'alpha3'; did you mean 'alpha"),
        ({"limits": -1.0}, "above zero, or a pair"),
        ({"vertices": 2}, "of at least 3"),
        ({"vertices": 24, "cost": "torque"}, "the torque of a polygon is infinite"),
        ({"objective": "displacement"}, "displaces nothing without rotation"),
        ({"starts": 0}, "starts must be a whole number of at least 1"),
        ({"objective": "displacement", "axis": "z"}, "axis must be x, y or a vector"),
        ({"objective": "target", "target": [1.0, 2.0]}, "pose of SE2"),
    ],
)
def test_optimise_gait_rejects_invalid_options(options: dict[str, object], message: str) -> None:
    """The message names the option."""
    with pytest.raises(pinred.InputError, match=re.escape(message)):
        pinred.optimise_gait(rods(), **options)  # type: ignore[arg-type]


def test_optimise_gait_with_three_joints_needs_cost_and_axis() -> None:
    """Three joints need a cost, and a rotation in space needs an axis."""
    A = pinred.Connection.mechanical(pinred.load("falling_cat"))
    with pytest.raises(pinred.InputError, match="expected a cost for 3 joints"):
        pinred.optimise_gait(A, axis="x", cost=None)
    with pytest.raises(pinred.InputError, match="for a rotation in space, got None"):
        pinred.optimise_gait(A)
