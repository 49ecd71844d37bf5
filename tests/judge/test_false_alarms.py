"""Correct random motions never fail the comparison (short form)."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from false_alarms import INACCURATE, _is_right, judged
from random_scenes import FAR, TINY, RandomScene, random_scene

import pinred
from pinred.forces import Torque
from pinred.judge.full_dynamics import FullDynamics


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("seed", range(5, 12 * 12, 24))
@pytest.mark.sampled(4)
def test_compare_of_correct_motion_does_not_fail(seed: int) -> None:
    """One scene of each of six trees; tests/helpers/false_alarms.py runs any number."""
    alarm = judged(seed)
    assert alarm.verdict in ("PASSED", "CANNOT TELL"), f"{alarm.about}: {alarm.message}"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    "seed",
    [
        300353,
        301051,
        305207,
        305311,
        330803,
        331983,
        333656,
        pytest.param(305596, marks=pytest.mark.by_hand),
    ],
)
@pytest.mark.sampled(4)
def test_compare_of_former_false_alarms_does_not_fail(seed: int) -> None:
    """Spheres on a lever, wrenches on falling or rotating bases, a stiff spring with Tsit5."""
    assert judged(seed).verdict == "PASSED"


# The criteria have a test of their own.
@pytest.mark.by_hand
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_motion_that_improves_with_tolerance_is_less_accurate() -> None:
    """A motion that does not improve is reported as wrong."""
    alarm = judged(300351)
    assert alarm.verdict == INACCURATE
    assert "FAILED" in alarm.message


def test_fast_force_at_a_switch_in_time_passes() -> None:
    """Beside a switch, ABA evaluates conditions at a near time, and all else at the time itself."""
    import casadi as ca

    def servo(s: Any) -> dict[str, Any]:
        clipped = ca.fmin(ca.fmax(0.5 * ca.sin(7.0 * s.t), -0.2), 0.2)
        return {"beanie": 3.0 * clipped + 5.0 * (0.2 * ca.cos(s.t) - s.xdot["beanie"])}

    traj = pinred.simulate(pinred.load("elroys_beanie"), duration=1.0, forces=[Torque(servo)])
    report = pinred.compare(traj)
    assert report.passed, report
    full, times = FullDynamics(traj.scene), np.array([1.0])
    states: Any = traj.motion.states(times)
    y = full.state(states.pose, states.x, states.xi, states.xdot)[0]
    full.set_parameters(traj.motion.numbers(times)[0])
    rate, theta, m = full.rate(1.0, y), float(states.xdot[0, 0]), full.system.sorted_model
    # M ẍ = τ with M = I₁ I₂ / (I₁ + I₂)
    I1, I2 = m.inertias[1].inertia[2, 2], m.inertias[2].inertia[2, 2]
    torque = 3.0 * 0.2 + 5.0 * (0.2 * np.cos(1.0) - theta)
    assert rate[-1] == pytest.approx(torque * (I1 + I2) / (I1 * I2), rel=1e-13)


@pytest.mark.parametrize(
    ("steps", "drift", "defect", "equations", "right"),
    [
        (9.0, 1.0, 0.09, 1.0, True),
        (0.9, 1.0, 0.09, 1.0, False),
        (9.0, 2.0, 0.09, 1.0, False),
        (9.0, 1.0, 0.2, 1.0, False),
        (9.0, 1.0, 0.09, 2.0, False),
    ],
)
def test_false_alarm_criteria_are_each_necessary(
    monkeypatch: pytest.MonkeyPatch,
    steps: float,
    drift: float,
    defect: float,
    equations: float,
    right: bool,
) -> None:
    """Only defects and final errors may exceed their bounds, and finer tolerances must reduce them.

    Each parameter alone turns the case into an alarm; values are relative to the bounds or to the
    first defect.
    """
    checks = {
        "defect of a step": (steps, 1.0),
        "shape error": (2.0, 1.0),
        "energy drift": (drift, 1.0),
    }
    again = SimpleNamespace(equations=equations, equations_bound=1.0, defect=defect * steps)
    monkeypatch.setattr(pinred, "compare", lambda _: again)
    scene = random_scene(300351)
    monkeypatch.setattr(RandomScene, "simulate", lambda _: None)
    result: Any = SimpleNamespace(checks=checks, defect=steps, defect_bound=1.0)
    assert _is_right(scene, result) is right


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("robot", ["planar_chain5", "reaction_wheel_satellite", "rigid_body"])
@pytest.mark.parametrize(("speed", "offset"), [(TINY, 0.0), (1.0, FAR)])
@pytest.mark.sampled(3)
def test_compare_of_extreme_values_does_not_fail(robot: str, speed: float, offset: float) -> None:
    """Underflowing squares of rates, and positions with round-off of micrometres."""
    rng = np.random.default_rng(4)
    system = pinred.load(robot)
    pose = np.array(system.group.exp(rng.uniform(-1.0, 1.0, system.r)))
    pose[: system.group.linear] += offset
    report = pinred.compare(
        pinred.simulate(
            system,
            x0=rng.uniform(-1.0, 1.0, system.m),
            xdot0=speed * rng.normal(size=system.m),
            xi0=speed * rng.normal(size=system.r),
            pose0=pose,
            duration=0.5,
        )
    )
    expected = "CANNOT TELL" if speed == TINY else "PASSED"
    assert str(report.verdict) == expected, str(report)


@pytest.mark.by_hand
def test_compare_of_motion_between_rests_does_not_fail() -> None:
    """At rest, accelerations consist of round-off alone."""
    rods = pinred.load("three_rods")
    angle = "(2*pi*t/2.0 - sin(2*pi*t/2.0))"
    plan = {"alpha1": f"0.3 - 0.3*cos({angle})", "alpha2": f"0.7*sin({angle})"}
    for duration in (2.0, 4.0):
        report = pinred.compare(
            pinred.simulate(
                rods, x0=[0.0, 0.0], momentum=0, prescribed=plan, duration=duration, rtol=1e-12
            )
        )
        assert report.passed, report
