"""Tests of gait optimisation against published values, ABA, RNEA and differences."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from assertions import close
from inverse_dynamics import joint_torques
from lifts import by_pinocchio
from scipy.optimize import nnls
from three_links import CENTRES, LENGTH, LINKS

import pinred
from pinred.analysis.phases.path_basis import fourier_rows
from pinred.common.arrays import Array
from pinred.planning.optimisation import gait_search, optimise
from pinred.planning.optimisation.gait_search import fourier_path_of
from pinred.planning.optimisation.ipopt import Minimum, Problem, kkt_residual, minimum
from pinred.planning.optimisation.limits import limits_of
from pinred.planning.optimisation.loop_peaks import cells_of, loop_peaks
from pinred.planning.optimisation.objective import COSTS, axis_aim, target_aim
from pinred.planning.optimisation.transcription import Task, problem_of

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
    assert first.found >= 4
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
    assert re.search(r"time +\S+ +T, the period", str(best))


@pytest.mark.by_hand
def test_limits_hold_between_sample_times(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the last stage the limits are violated."""
    best = pinred.optimise_gait(rods(), cost="power", limits=1.0, harmonics=3, starts=1)
    assert np.abs(best.gait.limits).max() <= 1.0
    monkeypatch.setattr(optimise, "finish", lambda s, gait: (s, s.optimise_from(gait)))
    loose = pinred.optimise_gait(rods(), cost="power", limits=1.0, harmonics=3, starts=1)
    assert np.abs(loose.gait.limits).max() > 1.0001


def test_optimum_within_limits_satisfies_kkt_conditions_of_ellipses() -> None:
    """An ellipse has extremes mean ± √(cos² + sin²): its KKT conditions have a closed form."""
    A = rods()
    best = pinred.optimise_gait(A, harmonics=1, limits=1.0, starts=1)
    assert best.merit >= 0.10327496
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
    assert residual < 1e-6 * best.merit


def test_cells_that_the_last_stage_exceeds_are_added(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without initial cells, a second round finds the same optimum; one round is too few."""
    monkeypatch.setattr(gait_search, "_NEAR", 9.0)
    best = pinred.optimise_gait(rods(), harmonics=1, limits=1.0, starts=1)
    assert best.merit == pytest.approx(0.1032749605, rel=1e-7)
    assert 0.0 <= best.margins["limits"] < 2e-8
    monkeypatch.setattr(gait_search, "_ROUNDS", 1)
    with pytest.raises(pinred.NoOptimum, match="exceeds its limits"):
        pinred.optimise_gait(rods(), harmonics=1, limits=1.0, starts=1)


def test_last_stage_returns_no_worse_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """If the last stage ends at a worse loop, the optimum of the search is returned."""
    A = rods()
    task = Task(
        A, axis_aim(A.group, "rotation", None), "torque", None, limits_of(A, 9.0, None, None), 1.0
    )
    search = gait_search.Search(task, fourier_path_of(task, 1))
    start = pinred.Gait.fourier([0.3, -0.2], [[1.0, 0.2]], [[0.1, 0.9]])
    gait = search.gait(search.optimise_from(start).z)
    stuck = gait_search.Search.optimise_from

    def worse(self: gait_search.Search, loop: pinred.Gait, *, most: int) -> Minimum:
        best = stuck(self, loop, most=most)
        return replace(best, z=1.1 * best.z, residual=0.0)

    monkeypatch.setattr(gait_search.Search, "optimise_from", worse)
    finished, best = gait_search.finish(search, gait)
    close(best.z, search.unknowns(gait), 1e-12)
    assert best.residual == kkt_residual(problem_of(task, finished.path), best.z) < 1e-5


def test_loops_stay_near_their_limits_between_limited_cells() -> None:
    """With no cells, the sample times limit the loop to 1.001 of its limits."""
    A = rods()
    limits = limits_of(A, 1.0, 3.0, None)
    task = Task(A, axis_aim(A.group, "rotation", None), "length", None, limits, 1.0)
    path = fourier_path_of(task, 1)
    none = cells_of(limits, 1).select(np.zeros(len(cells_of(limits, 1).joint), dtype=bool))
    z = minimum(problem_of(task, replace(path, cells=none)), np.full(path.size, 0.1)).z
    values, slopes, _ = path.checked
    c = path.coefficients(z)
    assert 1.0 < np.abs(values @ c).max() <= 1.001 + 1e-7
    assert np.abs(slopes @ c).max() <= 3.003 + 1e-6


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


@pytest.mark.by_hand
def test_peaks_of_loop_equal_those_of_fine_grid() -> None:
    """Maxima of shapes, speeds and torques in every cell, torques by RNEA."""
    A, T, system = rods(), 1.3, pinred.load("three_rods")
    limits = limits_of(A, [(-0.5, 1.0), (-1.0, 1.0)], 2.0, 0.3)
    c = np.random.default_rng(5).uniform(-0.5, 0.5, (5, 2))
    cells = cells_of(limits, 2)
    peaks = loop_peaks(A, limits, c, T, cells).values
    s = (np.arange(cells.count)[:, None] + np.linspace(0.0, 1.0, 301)) / cells.count
    x, rate, bend = (row @ c for row in fourier_rows(2, s.ravel()))
    states = zip(x, rate / T, bend / T**2, strict=True)
    tau = np.array([joint_torques(system, *state) for state in states])
    scaled = np.stack([(x - limits.middle) / limits.reach, rate / T / 2.0, tau / 0.3])
    on_grid = np.abs(scaled).reshape(3, cells.count, 301, 2).max(axis=2)
    expected = on_grid.transpose(0, 2, 1).ravel()
    assert (peaks >= expected * (1.0 - 1e-12)).all()
    close(peaks, expected, 1e-4)


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


def test_bound_on_cost_is_used_and_result_beats_random_loops() -> None:
    """The bound is active, and random loops of this length rotate less."""
    best = pinred.optimise_gait(rods(), most=0.2, harmonics=1, starts=1)
    assert best.cost <= 0.2 + 1e-9
    rng, A = np.random.default_rng(0), rods()
    for _ in range(20):
        mean, cos, sin = rng.uniform(-1.5, 1.5, (3, 2))
        gait = pinred.Gait.fourier(mean, [cos], [sin])
        p = pinred.phase(A, gait.scaled(0.2 / pinred.phase(A, gait).length))
        if p.length <= 0.2:
            assert abs(p.pose[2]) < best.value


@pytest.mark.parametrize("exact", [False, True])
@pytest.mark.parametrize("cost", COSTS)
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
            path = fourier_path_of(task, 2)
            if exact:
                path = replace(path, cells=cells_of(limits, 2), action=0.3)
            problem = problem_of(task, path)
            rng = np.random.default_rng(3)
            z = np.append(rng.uniform(-0.5, 0.5, path.size), 1.3)[: problem.size]
            along_z, step = rng.normal(size=problem.size), 1e-5 if exact else 1e-3
            expected = sum(
                weight * problem.evaluate(z + k * step * along_z)[0] / (12.0 * step)
                for k, weight in ((1, 8.0), (-1, -8.0), (2, -1.0), (-2, 1.0))
            )
            found = problem.evaluate(z)[1] @ along_z
            size = 1.0 + np.abs(expected)
            close(found / size, expected / size, 1e-6 if exact else 1e-8)


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
        path = fourier_path_of(task, 1)
        root = problem_of(task, path).evaluate(path.unknowns(c))[0][0]
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
    newton = minimum(problem(-9.0, 9.0), np.zeros(1), newton=True)
    assert newton.z == pytest.approx(2.0, abs=1e-8)


def test_wrong_winding_number_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    """The winding number is checked at the end, independently of the continuation."""
    monkeypatch.setattr(pinred.Gait, "winding", lambda _: 3.0)
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
