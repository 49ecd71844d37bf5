"""Flights of least effort, against closed forms, simulations and another transcription."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flight_reference import least_torque

import pinred
from pinred import InputError
from pinred.cli.command_line import main
from pinred.common.arrays import Array
from pinred.lie.rotations import quaternion_exp, quaternion_log, quaternion_product

START = [0.5, -0.4, 0.6, -0.3, 0.4]
MOMENTUM = [0.0, 0.0, 10.0]
COAST = 0.8809883060145649  # rotation of the chain with joints at rest [rad]
STANDING = np.array([0.0, 0.8, -1.6] * 4)
_LEG = """
<body name="{0}_hip" pos="{1} {2} 0">
  <joint name="{0}_roll" axis="1 0 0" range="-0.8 0.8"/>
  <inertial pos="0 {3} 0" mass="0.7" diaginertia="0.0008 0.001 0.0008"/>
  <body name="{0}_thigh" pos="0 {4} 0">
    <joint name="{0}_hip" axis="0 1 0" range="-1.2 2.6"/>
    <inertial pos="0 0 -0.08" mass="1.0" diaginertia="0.006 0.006 0.001"/>
    <body name="{0}_shank" pos="0 0 -0.21">
      <joint name="{0}_knee" axis="0 1 0" range="-2.6 -0.3"/>
      <inertial pos="0 0 -0.09" mass="0.25" diaginertia="0.0012 0.0012 0.0001"/>
    </body>
  </body>
</body>"""
_LEGS = "".join(
    _LEG.format(name, x, y, 0.3 * y, 0.7 * y)
    for name, x, y in (
        ("fl", 0.2, 0.11), ("fr", 0.2, -0.11), ("hl", -0.2, 0.11), ("hr", -0.2, -0.11),
    )
)  # fmt: skip
QUADRUPED = f"""
<mujoco model="quadruped"><compiler angle="radian"/><worldbody><body name="trunk">
<freejoint/><inertial pos="0.01 0 0.01" mass="6" diaginertia="0.03 0.07 0.08"/>{_LEGS}
</body></worldbody></mujoco>"""


@cache
def chain() -> pinred.System:
    """Five links on a free base in the plane."""
    return pinred.load("planar_chain5")


@cache
def chain_lands() -> pinred.FlightPlan:
    """Plan a flight of the chain."""
    return pinred.reorient(
        chain(), COAST + 0.3, limits=1.5, torques=3.0, x0=START, momentum=MOMENTUM, duration=1.5,
        effort="torque",
    )  # fmt: skip


def assert_within_limits(plan: pinred.FlightPlan, limits: Any, torques: Any) -> None:
    """Check the simulated motion at many times, and its end."""
    traj = plan.trajectory
    low, high = np.transpose(limits)
    fine = pinred.simulate(
        plan.system, x0=plan.shapes[0], momentum=plan.momentum, prescribed=plan.prescribed,
        times=np.linspace(0.0, plan.duration, 3001), rtol=1e-11, atol=1e-13,
    )  # fmt: skip
    assert plan.missed < 1e-6
    assert ((fine.x >= low) & (fine.x <= high)).all()
    assert (np.abs(fine.driving_torques) <= torques).all()
    np.testing.assert_allclose(traj.xdot[[0, -1]], 0.0, atol=1e-9)


def test_flight_of_one_joint_has_the_torque_of_the_closed_form() -> None:
    """Elroy's beanie: τ = M ẍ, and the least mean of τ² from rest to rest is 12 M² Δx² / T⁴."""
    beanie, step, seconds, turned = pinred.load("elroys_beanie"), 1.5, 2.0, 0.3
    reduction = pinred.Reduction(beanie)
    metric, inertia = reduction.reduced_metric([0.0])[0, 0], reduction.locked_inertia([0.0])[0, 0]
    target = turned - reduction.local_connection([0.0])[0, 0] * step
    plan = pinred.reorient(
        beanie, target, x0=[0.0], x_end=[step], momentum=[turned * inertia / seconds],
        duration=seconds, effort="torque",
    )  # fmt: skip
    assert plan.cost == pytest.approx(12.0 * metric**2 * step**2 / seconds**4, rel=1e-9)
    assert plan.missed < 1e-9
    assert plan.reached


def test_flight_lands_within_limits_and_compare_agrees() -> None:
    """The simulated motion lands, and its driving torques have the stated mean square."""
    plan = chain_lands()
    assert plan.reached
    assert plan.shortest is None
    assert_within_limits(plan, [[-1.5, 1.5]] * 5, 3.0)
    np.testing.assert_allclose(plan.trajectory.x[-1], START, atol=1e-9)
    traj = plan.trajectory
    mean = np.trapezoid((traj.driving_torques**2).sum(axis=1), traj.t) / plan.duration
    assert plan.cost == pytest.approx(mean, rel=2e-3)
    assert plan.kkt < 1e-6
    assert plan.violation < 1e-8
    assert plan.report.passed
    assert "torques of joint3" in plan.active


@pytest.mark.by_hand
def test_flight_another_transcription_finds_no_less_torque() -> None:
    """CasADi's own derivatives of a transcription with states and controls, from eight starts."""
    plan = chain_lands()
    costs = least_torque(chain(), plan, limit=1.5, torque=3.0, starts=8)
    assert plan.cost < 1.01 * np.nanmin(costs)
    assert np.nanmin(costs) < 1.02 * plan.cost


OUT_OF_REACH: Any = {
    "limits": 1.5, "torques": 1.0, "x0": [0.4, 0.5], "momentum": [0.0, 0.0, 0.5],
    "effort": "torque",
}  # fmt: skip


@cache
def rods_too_late() -> pinred.FlightPlan:
    """Plan a flight of three rods that is too short."""
    rods = pinred.load("three_rods")
    plan: pinred.FlightPlan = pinred.reorient(rods, 3.4, duration=0.3, **OUT_OF_REACH)
    return plan


def test_flight_out_of_reach_ends_nearest_and_states_the_shortest_duration() -> None:
    """The plan uses its limits."""
    plan = rods_too_late()
    assert not plan.reached
    assert plan.missed == pytest.approx(plan.remaining, abs=1e-7)
    assert 1.0 < plan.missed < 1.2
    peak = np.abs(plan.trajectory.driving_torques).max()
    assert 0.99 < peak <= 1.0
    assert "torques of alpha1" in plan.active
    assert plan.shortest is not None
    assert f"{plan.shortest:.4g} s suffice" in str(plan)


@pytest.mark.by_hand
def test_flight_in_little_more_than_the_shortest_duration_arrives() -> None:
    """Three percent more than the stated duration suffice."""
    shortest = float(rods_too_late().shortest or np.nan)
    again = pinred.reorient(
        pinred.load("three_rods"), 3.4, duration=1.03 * shortest, **OUT_OF_REACH
    )
    assert again.reached


@pytest.mark.by_hand
def test_flight_in_less_than_the_shortest_duration_misses() -> None:
    """No start reaches the target in five percent less than the stated duration."""
    seconds = 0.95 * float(rods_too_late().shortest or np.nan)
    plan = pinred.reorient(pinred.load("three_rods"), 3.4, duration=seconds, **OUT_OF_REACH)
    assert not plan.reached
    assert plan.missed > 1e-2


def test_flight_refuses_incomplete_options() -> None:
    """Each message names the option."""
    options = {"x0": START, "momentum": MOMENTUM, "limits": 1.5}
    for more, reason in (
        ({"effort": "torque"}, "duration: "),
        ({"effort": "work", "duration": 1.0}, "effort"),
        ({"effort": "rate", "duration": 1.0, "cycles": 2}, "cycles: "),
        ({"x_end": START}, "x_end: "),
        ({"effort": "rate", "duration": 1.0, "x_end": [2.0] * 5}, "x_end must lie within"),
        ({"torques": 3.0, "duration": 1.0}, 'pass effort="torque"'),
    ):
        with pytest.raises(InputError, match=reason):
            pinred.reorient(chain(), 0.3, **options, **more)  # type: ignore[call-overload]
    with pytest.raises(InputError, match="without ball joints"):
        pinred.reorient(pinred.load("falling_cat_ball"), [0, 0.1, 0], duration=1.0, effort="rate")


TOO_FAST: dict[str, Any] = {"limits": 2.5, "x0": [0.4, 0.5], "torques": 0.5, "duration": 1.0}


def test_loop_too_fast_for_torques_names_the_flight_that_is_possible() -> None:
    """The loop needs more time than the least-torque motion with the same limits."""
    with pytest.raises(InputError, match=r'need 1\.8. s for this loop.*effort="torque"'):
        pinred.reorient(pinred.load("three_rods"), 0.3, **TOO_FAST)


@pytest.mark.by_hand
def test_flight_is_possible_where_the_loop_is_too_fast() -> None:
    """The message of the loop proposes this flight."""
    plan = pinred.reorient(pinred.load("three_rods"), 0.3, effort="torque", **TOO_FAST)
    assert plan.reached
    assert_within_limits(plan, [[-2.5, 2.5]] * 2, 0.5)


def test_flight_by_file_and_command_is_that_of_python(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A gait file and the command line state the same options by the same names."""
    file, out = tmp_path / "flight.toml", tmp_path / "flight.npz"
    file.write_text(
        'robot = "elroys_beanie"\n[reorient]\ntarget = -0.3333333333333333\nx0 = [0.0]\n'
        'x_end = [1.0]\nduration = 2.0\neffort = "torque"\n'
    )
    plan = pinred.reorient(
        pinred.load("elroys_beanie"),
        -1.0 / 3.0,
        x0=[0.0],
        x_end=[1.0],
        duration=2.0,
        effort="torque",
    )
    assert plan.reached
    calls: list[dict[str, str]] = []

    def planned(_: pinred.System, **options: Any) -> pinred.FlightPlan:
        calls.append({name: str(value) for name, value in options.items()})
        return plan

    monkeypatch.setattr("pinred.planning.reorientation.reorient.reorient", planned)
    assert main(["reorient", str(file), "--out", str(out)]) == 0
    assert str(plan) in capsys.readouterr().out
    assert out.exists()
    options = ["--target=-0.3333333333333333", "--x0", "0", "--x-end", "1", "--duration", "2"]
    assert main(["reorient", "elroys_beanie", *options, "--effort", "torque"]) == 0
    assert str(plan) in capsys.readouterr().out
    stated = {"x0": "[0.0]", "x_end": "[1.0]", "duration": "2.0", "effort": "torque"}
    assert calls == [
        {"target": "-0.3333333333333333", **stated},
        {"target": "[-0.3333333333333333]", **stated},
    ]


def landing(system: pinred.System, x0: Array, seconds: float, pitch: float, turn: Array) -> Any:
    """Return momentum and target: the attitude with joints at rest, turned further by `turn`."""
    momentum = pinred.Reduction(system).locked_inertia(x0) @ np.array([0, 0, 0, 0, pitch, 0])
    still = pinred.simulate(
        system, x0=x0, momentum=momentum, duration=seconds,
        prescribed={name: repr(float(v)) for name, v in zip(system.shape_names, x0, strict=True)},
    )  # fmt: skip
    coast = quaternion_product(still.pose[0, 3:] * [-1, -1, -1, 1], still.pose[-1, 3:])
    return momentum, quaternion_log(quaternion_product(coast, quaternion_exp(turn)))


@pytest.mark.by_hand
@pytest.mark.parametrize("robot", ["solo12", "quadruped", "talos"])
def test_twenty_flights_land_within_all_limits(robot: str, tmp_path: Path) -> None:
    """All of 20 random targets are reached, in the simulation and at all times."""
    (tmp_path / "quadruped.xml").write_text(QUADRUPED)
    system = pinred.load(str(tmp_path / "quadruped.xml") if robot == "quadruped" else robot)
    x0, size, seconds, pitch = STANDING, 0.5, 0.5, 2.0
    limits: Any = np.transpose([STANDING - 1.5, STANDING + 1.5])
    torques: Any = 2.7
    if robot == "quadruped":
        x0, torques = np.array([0.0, 0.8, -1.5] * 4), 12.0
        limits = np.array([[-0.8, 0.8], [-1.2, 2.6], [-2.6, -0.3]] * 4)
    elif robot == "talos":
        model = system.model
        limits = np.transpose([model.lowerPositionLimit[7:], model.upperPositionLimit[7:]])
        torques = np.array(model.upperEffortLimit[6:])
        x0 = np.clip(0.0, limits[:, 0] + 0.1, limits[:, 1] - 0.1)
        size, seconds, pitch = 0.35, 0.8, 1.0
    for k in range(20):
        rng = np.random.default_rng(k)
        axis = rng.standard_normal(3)
        turn = axis / np.linalg.norm(axis) * rng.uniform(0.2, 1.0) * size
        momentum, target = landing(system, x0, seconds, pitch, turn)
        plan = pinred.reorient(
            system, target, limits=limits, torques=torques, x0=x0, momentum=momentum,
            duration=seconds, effort="torque",
        )  # fmt: skip
        assert plan.reached
        assert_within_limits(plan, limits, torques)
        assert plan.report.passed
