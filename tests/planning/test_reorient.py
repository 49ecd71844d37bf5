"""Tests of reorientation plans against SciPy with Pinocchio's mass matrix, and against full ABA."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from assertions import close
from inverse_dynamics import joint_torques
from lifts import by_pinocchio
from trees import random_model

import pinred
from pinred.common.arrays import Array
from pinred.planning.reorientation import turning_loop
from pinred.planning.reorientation.turning_loop import first_loop, passage_of

ROBOTS = {
    "falling_cat": 1.6,
    "satellite_two_arms": 2.6,
    "solo12": 1.0,
}  # limits of the joints [rad]


def random_target(rng: np.random.Generator, least: float = 20.0, most: float = 180.0) -> Array:
    """Draw a rotation vector of random direction, with an angle in a range [°]."""
    w = rng.normal(size=3)
    return np.asarray(np.radians(rng.uniform(least, most)) * w / np.linalg.norm(w))


def assert_rest_to_rest(plan: pinred.TurnPlan) -> None:
    """Check that the joints start and end at rest, in the same shape, within their limits."""
    traj = plan.trajectory
    start = plan.gait.at(0.0)[0]
    for k in (0, -1):
        close(traj.x[k], start, 1e-12)
        close(traj.xdot[k], np.zeros(plan.system.m), 1e-10)
    low, high = plan.gait.limits.T
    assert ((traj.x >= low - 1e-12) & (traj.x <= high + 1e-12)).all()


@pytest.mark.by_hand
def test_reorient_falling_cat_by_half_a_turn() -> None:
    """Half a turn about its length, confirmed by SciPy and full ABA."""
    cat = pinred.load("falling_cat")
    w = np.array([np.pi, 0.0, 0.0])
    plan = pinred.reorient(cat, w, limits=1.6)
    assert plan.remaining < 1e-9
    assert plan.missed < 1e-8
    assert plan.report.passed
    assert np.abs(plan.gait.limits).max() <= 1.6
    assert_rest_to_rest(plan)
    group = cat.group
    once = by_pinocchio(cat, plan.gait, np.zeros(6))
    pose = group.identity()
    for _ in range(plan.cycles):
        pose = group.compose(pose, once)
    wanted = group.exp(np.concatenate([np.zeros(3), w]))
    assert group.error(wanted, pose).rotation < 1e-8


@pytest.mark.by_hand
@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.48, -0.64, 0.6)])
def test_reorient_satellite_about_any_axis(axis: tuple[float, ...]) -> None:
    """A quarter turn by two arms, confirmed by full ABA."""
    satellite = pinred.load("satellite_two_arms")
    plan = pinred.reorient(satellite, 0.5 * np.pi * np.array(axis), limits=2.6)
    assert plan.missed < 1e-8
    assert plan.report.passed
    assert np.abs(plan.gait.limits).max() <= 2.6
    assert_rest_to_rest(plan)


@pytest.mark.by_hand
def test_reorient_solo12_in_free_fall() -> None:
    """Half a roll within one radian of each joint, confirmed by full ABA."""
    solo = pinred.load("solo12")
    assert solo.gravity.any()
    plan = pinred.reorient(solo, [np.pi, 0.0, 0.0], limits=1.0)
    assert plan.missed < 1e-8
    assert plan.report.passed
    assert np.abs(plan.gait.limits).max() <= 1.0
    assert_rest_to_rest(plan)
    before, after = plan.trajectory.pose[[0, -1]]
    up = np.array([pin.Quaternion(q[3:]).toRotationMatrix()[2, 2] for q in (before, after)])
    close(up, [1.0, -1.0], 1e-8)


@pytest.mark.by_hand
@pytest.mark.parametrize(("name", "seed"), [("satellite_two_arms", 2), ("falling_cat", 3)])
def test_reorient_reaches_random_targets(name: str, seed: int) -> None:
    """Targets are reached within limits; tests/helpers/gait_trials.py has more."""
    system = pinred.load(name)
    plan = pinred.reorient(
        system, random_target(np.random.default_rng(seed), 20.0, 60.0), limits=ROBOTS[name]
    )
    assert plan.missed < 1e-8
    assert np.abs(plan.gait.limits).max() <= ROBOTS[name]
    assert_rest_to_rest(plan)


@pytest.mark.by_hand
def test_reorient_planar_base_by_angle() -> None:
    """Three rods, also from their singular straight shape; a full turn needs several cycles."""
    rods = pinred.load("three_rods")
    for angle, start in ((0.5, {"alpha1": 0.4, "alpha2": 0.5}), (-7.0, None)):
        plan = pinred.reorient(rods, angle, limits=2.5, x0=start)
        close(plan.gait.at(0.0)[0], list(start.values()) if start else [0.0, 0.0], 1e-12)
        pose = by_pinocchio(rods, plan.gait, np.zeros(3))
        assert plan.cycles * pose[2] == pytest.approx(angle, abs=1e-9)
    assert plan.cycles > 1


def test_reorient_duration_respects_speeds_and_torques() -> None:
    """Peaks by differences, torques by RNEA; a shorter duration is rejected."""
    rods = pinred.load("three_rods")
    options: dict[str, Any] = {"limits": 2.5, "x0": [0.4, 0.5]}
    plan = pinred.reorient(rods, 0.3, **options, speeds=1.0, torques=0.02)
    traj = plan.trajectory
    fastest = np.abs(traj.xdot).max()
    strongest = np.abs(traj.driving_torques).max()
    assert fastest <= 1.0
    assert strongest <= 0.02
    assert max(fastest, strongest / 0.02) > 0.98
    k, h = 60, 1e-4
    t = float(traj.t[k])
    bend = (traj(t + h).xdot - traj(t - h).xdot) / (2.0 * h)
    tau = joint_torques(rods, traj.x[k], traj.xdot[k], bend)
    close(traj.driving_torques[k], tau, 1e-6)
    with pytest.raises(pinred.InputError, match="speeds and torques need"):
        pinred.reorient(rods, 0.3, **options, speeds=1.0, torques=0.02, duration=0.5)


@pytest.mark.parametrize("name", ["falling_cat", "satellite_two_arms"])
def test_first_loop_rotation_agrees_with_curvature(name: str) -> None:
    """Small loops rotate by the curvature, with an error of the next order."""
    system = pinred.load(name)
    A = pinred.Connection.mechanical(system)
    start = np.full(system.m, 0.3)
    w = np.array([0.0, 1.0, 0.5]) if name == "falling_cat" else np.array([0.3, -1.0, 0.5])
    B = A.curvature(start)[3:]
    wrong = []
    for size in (1e-5, 2.5e-6):
        gait = first_loop(A, start, size * w, np.tile([-3.0, 3.0], (system.m, 1)))
        turned = pinred.phase(A, gait, tolerance=1e-13).log[3:]
        t = np.linspace(0.0, 1.0, 2001)[:-1]
        x, xdot = gait.at(t)
        S = np.einsum("ta,tb->ab", x - start, xdot) / len(t)
        expected = -0.25 * np.einsum("rab,ab->r", B, S - S.T)
        wrong.append(float(np.linalg.norm(turned - expected)) / size)
    assert wrong[1] < 0.6 * wrong[0]
    assert wrong[1] < 0.1 * np.linalg.norm(w)


def test_reorient_without_polish_misses_target(monkeypatch: pytest.MonkeyPatch) -> None:
    """IPOPT alone leaves an error that is rejected."""
    monkeypatch.setattr(turning_loop, "polish_loop", lambda _task, _aim, _path, y: y + 1e-8)
    with pytest.raises(pinred.NoOptimum, match=r"misses the target by"):
        pinred.reorient(pinred.load("three_rods"), 0.3, limits=2.5, x0=[0.4, 0.5], cycles=1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "omega", "target"),
    [
        ("three_rods", [0.1, -0.2, 1.5], [-0.7]),
        pytest.param(
            "falling_cat", [0.3, 0.2, -0.5, 0.7, -0.9, 1.2], [0.6, -0.3, 0.4],
            marks=pytest.mark.by_hand,
        ),
    ],
)  # fmt: skip
def test_reorient_with_momentum_passes_through_target(
    name: str, omega: list[float], target: list[float]
) -> None:
    """The final twist is that of the momentum; full ABA agrees."""
    system = pinred.load(name)
    red, start = pinred.Reduction(system), np.full(system.m, 0.2)
    limit = ROBOTS.get(name, 2.5)
    mu = red.locked_inertia(start) @ omega
    plan = pinred.reorient(system, target, limits=limit, x0=start, momentum=mu)
    assert plan.missed < 1e-8
    quicker = pinred.simulate(plan.trajectory.scene, rtol=1e-8, atol=1e-10)
    assert pinred.compare(quicker).passed
    assert np.abs(plan.gait.limits).max() <= limit
    assert_rest_to_rest(plan)
    group, k = system.group, system.group.linear
    wanted = group.exp(np.concatenate([np.zeros(k), target]))
    mu_there = group.Ad(plan.pose).T @ mu
    close(plan.left, np.linalg.solve(red.locked_inertia(start), mu_there), 1e-12)
    close(plan.trajectory.xi[-1][k:], plan.left[k:], 1e-9)
    assert group.error(wanted, plan.pose).rotation < 1e-8
    assert plan.tumble == pytest.approx(np.linalg.norm(plan.left[k:]))
    assert plan.tumble > 0.3
    assert "determined by the momentum" in str(plan)


def test_reorient_with_momentum_checks_limits() -> None:
    """Speeds hold or raise an error, and torques are rejected."""
    rods = pinred.load("three_rods")
    options: dict[str, Any] = {"limits": 2.5, "x0": [0.4, 0.5], "momentum": [0.0, 0.0, 0.01]}
    plan = pinred.reorient(rods, 0.3, **options, speeds=9.0)
    assert 0.0 <= plan.margins["speeds"] < 9.0
    assert np.abs(plan.trajectory.xdot).max() <= 9.0 - plan.margins["speeds"] + 1e-9
    with pytest.raises(pinred.InputError, match="how far the base drifts"):
        pinred.reorient(rods, 0.3, **options, speeds=0.1)
    with pytest.raises(pinred.InputError, match="limits of loops need zero momentum"):
        pinred.reorient(rods, 0.3, **options, torques=1.0)
    with pytest.raises(pinred.ShapeError, match="momentum"):
        pinred.reorient(rods, 0.3, **options | {"momentum": [0.1]})
    with pytest.raises(pinred.InputError, match="momentum"):
        pinred.reorient(rods, 0.3, **options | {"momentum": [0.0, 0.0, np.nan]})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"target": [0.1, 0.2]}, "pose of SE2"),
        ({"target": 0.0}, "nothing has to move"),
        ({"target": 0.3, "cycles": 0}, "cycles must be a whole number"),
        ({"target": 0.3, "x0": [3.0, 0.0], "limits": 1.0}, "x0 must lie within the limits"),
        ({"target": 0.3, "duration": -1.0}, "duration must be finite and above zero"),
    ],
)
def test_reorient_rejects_invalid_options(options: dict[str, Any], message: str) -> None:
    """The message names the option."""
    with pytest.raises(pinred.InputError, match=re.escape(message)):
        pinred.reorient(pinred.load("three_rods"), **options)


def test_target_of_another_length_is_explained() -> None:
    """The message names the two forms, and how to write a turn about one axis."""
    with pytest.raises(pinred.ShapeError, match=r"rotation vector \(3,\) \[rad\] or a pose \(7,\)"):
        pinred.reorient(pinred.load("falling_cat"), [0.5])


def test_reorient_unreachable_target_raises() -> None:
    """A joint with a tiny range cannot rotate the base far, and one joint cannot at all."""
    with pytest.raises(pinred.NoOptimum, match="give wider limits"):
        pinred.reorient(pinred.load("three_rods"), 3.0, limits=0.05, x0=[0.03, 0.03], cycles=1)
    with pytest.raises(pinred.InputError, match=r"needs two joints.*turns=\[1\]"):
        pinred.reorient(pinred.load("elroys_beanie"), 1.0)


def test_reorient_rejects_gravity_on_pivot() -> None:
    """Gravity on a pivoted base changes its momentum."""
    model = random_model("SO3", 2, 1)
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    with pytest.raises(pinred.SymmetryError, match="momenta are not conserved"):
        pinred.reorient(pinred.load(model), [0.0, 0.0, 0.1], limits=1.5)


@pytest.mark.parametrize(("angle", "accepted"), [(190.0, True), (210.0, False)])
def test_passage_rejects_tumbling_above_bound(angle: float, accepted: bool) -> None:
    """The bound is 200 rad with joints at rest, by Pinocchio's mass matrix."""
    rods, momentum, start = pinred.load("three_rods"), np.array([0.0, 0.0, 0.05]), [0.4, 0.5]
    connection = pinred.Connection.mechanical(rods)
    q = rods.q(rods.group.identity(), start)
    upper = pin.crba(rods.model, rods.data, q)[:3, :3]
    locked = np.triu(upper) + np.triu(upper, 1).T
    time = angle / abs(np.linalg.solve(locked, momentum)[2])
    if accepted:
        assert passage_of(connection, momentum, np.array(start), 1, time).more >= 4 * angle
        return
    with pytest.raises(pinred.InputError, match="tumble through 210 rad"):
        passage_of(connection, momentum, np.array(start), 1, time)
