"""Comparison of all robots with ABA, and detection of wrong trajectories."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tampering import offset, tampered
from trees import random_model

import pinred
from pinred.judge.reference_solution import FullMotion, FullState
from pinred.lie import GROUPS
from pinred.system.find_robot_files import bundled_robots, has_example_robots

EXAMPLES = {"solo12": 2.0, "ur5": 3.0, "talos": 0.5}


@pytest.mark.by_hand("double_spherical_pendulum", "planar_chain5")
@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(bundled_robots()))
@pytest.mark.sampled(4)
def test_compare_passes_for_bundled_robot(name: str) -> None:
    """Every bundled robot agrees with ABA from its default initial state.

    Motions last as long as by default, those of robots with closed loops 0.3 s.
    """
    system = pinred.load(name)
    traj = pinred.simulate(system, duration=0.3 if system.loops else None)
    report = pinred.compare(traj)
    assert report.passed, str(report)
    assert report.growth[-1] < 1e4
    assert report.reference_error < 1e-9 * report.growth[-1]


# Bundled robots and random trees are compared by default.
@pytest.mark.by_hand
@pytest.mark.slow
@pytest.mark.skipif(not has_example_robots(), reason="needs example-robot-data")
@pytest.mark.parametrize("name", sorted(EXAMPLES))
@pytest.mark.sampled
def test_compare_passes_for_example_robot(name: str) -> None:
    """A quadruped, an arm on a free base and a humanoid, tumbling and falling."""
    report = pinred.compare(
        pinred.simulate(pinred.load(name, group="SE3"), seed=1, duration=EXAMPLES[name])
    )
    assert report.passed, str(report)


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed", [0, 3, *(pytest.param(k, marks=pytest.mark.by_hand) for k in (1, 2))]
)
@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.sampled(4)
def test_compare_passes_for_random_trees(group: str, seed: int) -> None:
    """Trees of every group with springs, armature, a moved pose, and gravity if invariant."""
    model = random_model(group, seed + 1, seed)
    if GROUPS[group].linear:
        model.gravity.linear = np.array([1.0, -2.0, 3.0])
    system = pinred.load(model)
    springs = dict.fromkeys(system.shape_names[:2], (1.0, 0.2))
    pose0 = system.group.exp(np.linspace(0.3, -0.9, system.r))
    report = pinred.compare(
        pinred.simulate(system, seed=seed, duration=1.5, pose0=pose0, springs=springs)
    )
    assert report.passed, str(report)


@pytest.mark.slow
def test_error_decreases_with_tolerance() -> None:
    """The error stays within a factor of the tolerance, down to round-off."""
    system = pinred.load("falling_cat")
    errors = {}
    for rtol in (1e-5, 1e-8, 1e-11):
        traj = pinred.simulate(system, duration=4.0, rtol=rtol, atol=rtol / 100)
        report = pinred.compare(traj)
        assert report.passed, str(report)
        errors[rtol] = max(report.shape_error, report.rotation_error)
        assert errors[rtol] < 100 * report.growth[-1] * rtol
    assert errors[1e-5] > 30 * errors[1e-8] > 900 * errors[1e-11]


@pytest.mark.parametrize(
    ("name", "column", "size", "check"),
    [
        ("x", 0, 1e-6, "shape error [rad | m]"),
        ("q", 0, 1e-6, "position error [m]"),
        ("q", 4, 1e-6, "rotation error [rad]"),
        ("v", 6, 1e-4, "energy drift [relative]"),
        ("v", 4, 1e-4, "momentum drift [relative]"),
        ("x", 0, np.nan, "shape error [rad | m]"),
        ("pose", 1, 1e-6, "fields against q, v"),
        ("xi", 3, 1e-6, "fields against q, v"),
        ("xdot", 0, 1e-6, "fields against q, v"),
        ("body_momentum", 2, 1e-6, "fields against q, v"),
        ("spatial_momentum", 5, 1e-6, "fields against q, v"),
    ],
)
@pytest.mark.sampled(3)
def test_compare_fails_for_wrong_trajectory(
    name: str, column: int, size: float, check: str
) -> None:
    """A relative error of 1e-6 in shape, base or velocity fails the corresponding check."""
    traj = pinred.simulate(pinred.load("falling_cat"), duration=1.0)
    assert pinred.compare(traj).passed
    report = pinred.compare(tampered(traj, offset(name, column, size)))
    value, bound = report.checks[check]
    assert not value <= bound
    assert not report.passed
    assert "verdict: FAILED" in str(report)


def test_compare_fails_for_wrong_mass() -> None:
    """A relative mass error of 1e-6 fails."""
    system = pinred.load("falling_cat")
    traj = pinred.simulate(system, duration=5.0)
    other = pinred.load("falling_cat")
    other.model.inertias[2].mass *= 1.0 + 1e-5
    report = pinred.compare(
        pinred.Trajectory(replace(traj.scene, system=other), traj.motion, traj.run)
    )
    assert report.verdict == "FAILED"
    value, bound = report.checks["equations of motion [relative]"]
    assert value > 100.0 * bound


def test_compare_fails_for_constant_energy_offset() -> None:
    """The energy must equal Pinocchio's, also on a tilted falling root."""
    model = random_model("SE2", 2, 3)
    model.gravity.linear = np.array([1.0, -2.0, 3.0])
    traj = pinred.simulate(pinred.load(model), seed=1, duration=1.0)
    assert pinred.compare(traj).passed

    def lifted(state: pinred.State) -> pinred.State:
        return replace(state, energy=state.energy + 1e-6)

    assert not pinred.compare(tampered(traj, lifted)).passed


def test_scene_that_reports_only_its_start_is_compared_to_its_end() -> None:
    """The comparison has times of its own there."""
    traj = pinred.simulate(pinred.load("rigid_body"), seed=1, duration=0.5, times=[0.0])
    report = pinred.compare(traj)
    assert report.t[-1] == 0.5
    assert report.verdict == "PASSED"


# The previous test reports only the start, and test_bounds_of_compare.py has a chaotic motion.
@pytest.mark.by_hand
@pytest.mark.slow
def test_compare_of_chaotic_motion_cannot_tell() -> None:
    """A scene that reports only its start is compared until errors cannot be judged."""
    system = pinred.load("double_spherical_pendulum")
    traj = pinred.simulate(
        system, x0=[2.0, 1.0, 2.5], xdot0=[4.0, -5.0, 6.0], xi0=[3.0], duration=15.0, times=[0.0],
        rtol=1e-6, atol=1e-8,
    )  # fmt: skip
    report = pinred.compare(traj)
    assert report.t[-1] == 15.0
    assert report.growth[-1] > 1e5
    assert 0 < report.told < len(report.t)
    assert report.verdict == "CANNOT TELL"
    assert not report
    assert "can be judged until t = " in report.reasons[0]


def test_reference_error_bounds_distance_to_closed_form() -> None:
    """The difference of the two references bounds their error."""
    system = pinred.load("elroys_beanie")
    k = 3.0
    full = FullState(pinred.Scene(system=system, springs={"beanie": (k, 0.0)}))
    y0 = full.state(np.zeros(1), np.array([0.5]), np.array([0.8]), np.array([-0.4]))
    times = np.linspace(0.0, 10.0, 11)
    eight = full.run(y0, times, 1e-12, 1e-14)
    five = full.run(y0, times, 1e-12, 1e-14, method="dopri5")
    w = np.sqrt(k * 3.0 / 2.0)
    exact = 0.5 * np.cos(w * times) - 0.4 / w * np.sin(w * times)
    assert np.abs(eight.x[:, 0] - exact).max() < 2e-11
    assert full.distance(eight, five).worst(full.size(eight)) < 1e-10


def test_report_text_contains_checks() -> None:
    """Names, values and bounds are in the text; arrays are over the compared times."""
    traj = pinred.simulate(pinred.load("coupled_planar"), duration=1.0, times=[0.0, 0.5, 1.0])
    report = pinred.compare(traj)
    text = str(report)
    for name, (value, bound) in report.checks.items():
        assert name in text
        assert f"{value:.2e}" in text
        assert f"{bound:.1e}" in text
    assert report.shape_errors.shape == (*report.t.shape, traj.system.m)
    assert report.rotation_errors.shape == report.position_errors.shape == report.t.shape
    assert set(traj.t) <= set(report.t)
    assert report.shape_error == report.shape_errors.max()
    assert report.wall_reduced > 0.0
    assert report.wall_full > 0.0


@pytest.mark.parametrize("group", [name for name in GROUPS if GROUPS[name].turns])
@pytest.mark.parametrize("angle", [1e-3, 1e-6, 3e-9, 1e-12])
@pytest.mark.sampled(4)
def test_small_rotation_is_measured_at_any_pose(group: str, angle: float) -> None:
    """The distance of two slightly rotated bases is independent of their pose."""
    system = pinred.load(random_model(group, 2, 1))
    judge = FullState(pinred.Scene(system=system, seed=0))
    rng = np.random.default_rng(0)
    turn = np.zeros(system.r)
    turn[-1] = angle
    x = np.zeros(2)
    for _ in range(50):
        pose = system.group.exp(rng.normal(size=system.r))
        poses = (pose, system.group.compose(pose, system.group.exp(turn)))
        first, second = (FullMotion(x[None], system.q(p, x)[None]) for p in poses)
        result = judge.distance(first, second)
        assert result.rotation[0] == pytest.approx(angle, rel=1e-6, abs=1e-15)
        assert result.position[0] < 1e-14
