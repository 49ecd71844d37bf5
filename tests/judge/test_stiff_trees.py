"""Verdicts on random stiff trees are never wrong, and faults planted in them are found."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from stiff_study import AGREES, _changed, planted_fault, scipy_difference, study
from stiff_trees import stiff_tree

import pinred
from pinred.common.arrays import Array
from pinred.forces import Force
from pinred.judge.reference_solution import FullState
from pinred.judge.step_defects import compute_defects
from pinred.reduction.pointwise_reduction import PointwiseReduction

QUICK = (4, 10)  # short runs; other tests have dampers, PD control, and wrong forces and masses


@pytest.mark.by_hand("10")
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    "seed", [pytest.param(k, marks=() if k in QUICK else pytest.mark.by_hand) for k in range(300)]
)
def test_verdict_on_stiff_tree_and_on_planted_fault(seed: int) -> None:
    """SciPy's Radau contradicts no verdict on the motion, and the fault is FAILED."""
    about, outcome, report, kind, fault = study(seed)
    assert "contradicted" not in outcome, f"{about}: {report}"
    assert fault.verdict == "FAILED", f"{about}, {kind}: {fault}"


@pytest.mark.filterwarnings("ignore")
def test_error_between_report_times_cannot_tell() -> None:
    """Dense output of DOP853 is wrong by 4e-7 in a step 20 times as long as the fastest decay."""
    scene = stiff_tree(104).scene
    report = pinred.compare(pinred.simulate(scene))
    assert report.verdict == "CANNOT TELL", str(report)
    assert "between report times" in report.reasons[0]
    traj = pinred.simulate(scene, times=np.linspace(0.0, scene.end, 101))
    assert pinred.compare(traj).verdict == "FAILED"


@pytest.mark.by_hand
@pytest.mark.filterwarnings("ignore")
def test_wrong_force_fails_although_errors_between_report_times_are_undecided() -> None:
    """The coefficient of a damper is wrong by a millionth."""
    scene = stiff_tree(104).scene
    traj = pinred.simulate(scene, times=np.linspace(0.0, scene.end, 101))
    forces = cast(tuple[Force, ...], scene.forces)
    wrong = replace(scene, forces=[_changed(force, 1.0 + 1e-6) for force in forces])
    assert pinred.compare(pinred.Trajectory(wrong, traj.motion, traj.run)).verdict == "FAILED"


@pytest.mark.filterwarnings("ignore")
def test_step_with_fast_motion_may_exceed_bound() -> None:
    """The rate of a light tip with a decay of 141/s has steps with 3.7 tolerances."""
    traj = pinred.simulate(stiff_tree(153).scene)
    report = pinred.compare(traj)
    assert report.passed, str(report)
    assert compute_defects(traj, FullState(traj.scene)).worst > 1.1 * 3.0 * 1.01e-10
    assert scipy_difference(traj) < 1e-10


@pytest.mark.filterwarnings("ignore")
def test_kinetic_energy_between_report_times_is_the_unit_of_drifts() -> None:
    """A hinge under PD control has 2 MJ for 60 µs, and 3 J at the start; its ODE is known.

    With the metric M(x) = a + b cos 2x + c sin 2x, M ẍ + M' ẋ²/2 is the torque.
    """
    scene = replace(stiff_tree(224).scene, duration=0.1, times=[0.0, 0.1])
    traj, reduction = pinred.simulate(scene), PointwiseReduction(scene.system)
    report = pinred.compare(traj)
    assert report.passed, str(report)
    forces: Any = scene.forces
    force = forces[0]
    name = scene.system.shape_names[0]
    x = np.array([0.0, 0.7, 1.5])
    basis = np.column_stack([np.ones(3), np.cos(2.0 * x), np.sin(2.0 * x)])
    a, b, c = np.linalg.solve(
        basis, [reduction.at(np.array([each])).reduced_metric[0, 0] for each in x]
    )
    kp, kd, goal = (each[name] for each in (force.kp, force.kd, force.reference))

    def rate(_: float, y: Array) -> Array:
        M, slope = a + b * np.cos(2 * y[0]) + c * np.sin(2 * y[0]), c * np.cos(2 * y[0])
        slope = 2.0 * (slope - b * np.sin(2 * y[0]))
        torque = kp * (goal - y[0]) - kd * y[1]
        return np.array([y[1], (torque - 0.5 * slope * y[1] ** 2) / M])

    times, start = np.linspace(0.0, 6e-5, 13), [scene.start.x[0], scene.start.xdot[0]]
    exact = solve_ivp(rate, (0.0, 6e-5), start, "DOP853", times, rtol=1e-12, atol=[1e-13, 1e-8])
    states = pinred.simulate(scene, times=times)
    assert np.abs(states.x[:, 0] - exact.y[0]).max() < 1e-10
    assert np.abs(states.xdot[:, 0] - exact.y[1]).max() < 1e-9 * np.abs(exact.y[1]).max()


@pytest.mark.parametrize("seed", [4, 47])
@pytest.mark.filterwarnings("ignore")
def test_planted_jumps_exceed_tolerance(seed: int) -> None:
    """An offset of a coordinate, and a jump of a rate with a unit of 1e4 rad/s."""
    traj = pinred.simulate(stiff_tree(seed).scene)
    _, wrong = planted_fault(traj, seed)
    steps = compute_defects(wrong, FullState(wrong.scene), max_steps=100_000).steps
    assert 1e-6 < 1.01 * steps[(len(steps) + 1) // 2 - 1] < 1e-3


# Two stiff trees are compared with SciPy by default.
@pytest.mark.by_hand
@pytest.mark.filterwarnings("ignore")
def test_scipy_confirms_motion_of_stiff_tree() -> None:
    """The independent integration that judges verdicts agrees with a passing motion."""
    traj = pinred.simulate(stiff_tree(0).scene)
    assert pinred.compare(traj).passed
    assert scipy_difference(traj) < AGREES
