"""Stops of ball joints: angle, swing and twist, against closed forms and rotation matrices."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from ball_trees import joined_bodies
from trees import random_model

import pinred
from pinred.common.arrays import Array
from pinred.common.errors import IntegrationError
from pinred.forces import Torque
from pinred.judge.verdict import Verdict
from pinred.scene.stop import BallBound, place

AXIS = (1.0, 2.0, 3.0)
KINDS = ("angle", "swing", "twist")


def spheres() -> pinred.System:
    """Return two concentric spheres of 0.4 and 0.1 kg m² that a ball joins."""
    moments = np.array([[0.4, 0.4, 0.4], [0.1, 0.1, 0.1]])
    return joined_bodies(moments, np.zeros((2, 3)))


def angle_by_matrices(kind: str, R: Array, n: Array) -> float:
    """Return a bounded angle by Pinocchio's logarithm and exponential."""
    if kind == "angle":
        return float(np.linalg.norm(pin.log3(R)))
    tilt = np.cross(n, R @ n)
    swing = float(np.arctan2(np.linalg.norm(tilt), n @ R @ n))
    if kind == "swing":
        return swing
    untilted = pin.exp3(swing * tilt / np.linalg.norm(tilt)).T @ R
    return float(n @ pin.log3(untilted))


@pytest.mark.parametrize("kind", KINDS)
def test_angles_of_balls_and_their_rates_agree_with_rotation_matrices(kind: str) -> None:
    """Rates are compared with central differences along a rotation of the child."""
    rng, step = np.random.default_rng(0), 1e-5
    for _ in range(100):
        stop = pinred.BallStop(swing=1.0, axis=tuple(rng.normal(size=3)))
        bound, n = BallBound("ball", 0, 0, 1.0, 1.0, 1.0, stop, kind), np.array(stop.axis)
        q, omega = rng.normal(size=4), rng.normal(size=3)
        q /= np.linalg.norm(q)
        R = pin.Quaternion(q).toRotationMatrix()
        np.testing.assert_allclose(bound.values(q), angle_by_matrices(kind, R, n), atol=1e-9)
        ends = [angle_by_matrices(kind, R @ pin.exp3(s * omega), n) for s in (-step, step)]
        rate = float(np.diff(ends)[0]) / (2.0 * step)
        if abs(rate) < 100.0:  # the angle may jump by a turn, and twists near a swing by π are fast
            np.testing.assert_allclose(bound.normal(q, 3) @ omega, rate, rtol=1e-5, atol=1e-6)
        moved = q.copy()
        near = BallBound("ball", 0, 0, 1.0, float(bound.values(q)) + 1e-9, 1.0, stop, kind)
        place([near], moved)
        np.testing.assert_allclose(near.values(moved), near.position, rtol=0.0, atol=1e-14)


def test_concentric_spheres_bounce_at_the_times_of_the_closed_form() -> None:
    """They turn about one axis at constant rates; the reduced inertia is 0.08 kg m²."""
    e, speed, limit = 0.8, 2.0, 0.5
    direction = np.array(AXIS) / np.linalg.norm(AXIS)
    traj = pinred.simulate(
        spheres(), xdot0=speed * direction, xi0=[0.1, 0.2, 0.3, *0.4 * direction], duration=2.0,
        stops={"joint": pinred.BallStop(angle=limit, restitution=e)},
    )  # fmt: skip
    table = traj.impacts
    k = np.arange(len(table))
    rates = speed * e**k
    times = limit / speed + np.cumsum(np.append(0.0, 2.0 * limit / rates[1:]))
    assert len(table) == 3
    assert table.side == ("angle",) * 3
    np.testing.assert_allclose(table.t, times, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(table.rate_before, rates, rtol=1e-9)
    np.testing.assert_allclose(table.impulse, -(1.0 + e) * 0.08 * rates, rtol=1e-9)
    np.testing.assert_allclose(table.energy_lost, 0.5 * 0.08 * (1.0 - e**2) * rates**2, rtol=1e-9)
    np.testing.assert_array_equal(table.momentum_before, table.momentum_after)


@pytest.mark.parametrize(
    "stop",
    [
        pinred.BallStop(angle=0.6, restitution=0.7),
        pinred.BallStop(swing=0.5, twist=(-0.4, 0.3), axis=AXIS, restitution=0.8),
    ],
    ids=["angle", "swing and twist"],
)
def test_balls_with_stops_pass_the_comparison(stop: pinred.BallStop) -> None:
    """The reference has formulas of its own for the angles and their rates."""
    traj = pinred.simulate(
        joined_bodies(), xdot0=[2.0, -1.0, 1.5], xi0=[0.1, 0.2, 0.3, 0.4, -0.2, 0.5],
        duration=1.2, stops={"joint": stop}, rtol=1e-8, atol=1e-10,
    )  # fmt: skip
    assert len(traj.impacts) >= 2
    if stop.swing < 1.0:
        assert set(traj.impacts.side) == {"swing", "lower", "upper"}
    report = pinred.compare(traj)
    assert report.verdict is Verdict.PASSED, report


@pytest.mark.parametrize("moments", [[0.1, 0.1, 0.1], [0.1, 0.1, 0.15]], ids=["rotor", "axial"])
def test_symmetric_balls_lose_their_constant_momenta_at_stops(moments: list[float]) -> None:
    """The ball has constant momenta between impacts, which a swing stop changes."""
    system = joined_bodies(np.array([[0.4, 0.5, 0.7], moments]), np.zeros((2, 3)))
    traj = pinred.simulate(
        system, xdot0=[2.0, -1.0, 1.5], xi0=[0.1, 0.2, 0.3, 0.4, -0.2, 0.5], duration=1.0,
        stops={"joint": pinred.BallStop(swing=0.5, restitution=0.8)}, rtol=1e-8, atol=1e-10,
    )  # fmt: skip
    assert len(traj.impacts) >= 2
    report = pinred.compare(traj)
    assert report.verdict is Verdict.PASSED, report


def test_balls_and_hinges_of_one_tree_bounce_and_rest() -> None:
    """While a hinge rests, balls bounce."""
    system = pinred.load(random_model("SE3", 4, 14, armature=False, balls=0.5))
    balls = [joint.name for joint in system.space.balls]
    hinges = [joint.name for joint in system.space.joints if not joint.kind.is_ball]
    assert balls
    assert hinges
    stops = dict.fromkeys(balls, pinred.BallStop(angle=0.4, restitution=0.8))
    traj = pinred.simulate(
        system, x0=system.space.neutral, xdot0=np.linspace(-1.5, 2.0, system.m), duration=0.6,
        stops={**stops, **dict.fromkeys(hinges, (-0.2, 0.2))}, rtol=1e-8, atol=1e-10,
    )  # fmt: skip
    assert {*traj.impacts.joint} >= {*balls[:1], *hinges[:1]}
    assert len(traj.motion.modes) >= 2
    report = pinred.compare(traj)
    assert report.verdict is not Verdict.FAILED, report


def test_rest_of_a_ball_is_refused_by_name() -> None:
    """A torque presses the ball against its stop, and its rebounds accumulate."""
    with pytest.raises(IntegrationError, match=r"ball joint 'joint'.*its angle stop at t = 0\.\d"):
        pinred.simulate(
            spheres(), xdot0=[2.0, 0.0, 0.0], duration=5.0,
            forces=[Torque(lambda *_: [1.0, 0.0, 0.0])],
            stops={"joint": pinred.BallStop(angle=0.5, restitution=0.3)},
        )  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "expected a finite angle"),
        ({"angle": 4.0}, "angle: expected"),
        ({"swing": 0.0}, "swing: expected"),
        ({"twist": (1.0, -1.0)}, "twist: expected"),
        ({"twist": (-1.0, np.inf)}, "twist: expected"),
        ({"angle": 1.0, "axis": (0.0, 0.0, 0.0)}, "axis: expected"),
        ({"angle": 1.0, "restitution": 0.0}, "restitution: expected .*three hinges"),
        ({"angle": 1.0, "restitution": np.nan}, "restitution: expected"),
        ({"angle": 1.0, "rest_rate": 0.0}, "rest_rate: expected"),
    ],
)
def test_bad_stops_of_balls_are_refused(arguments: dict[str, Any], message: str) -> None:
    """Messages name the argument."""
    with pytest.raises(pinred.InputError, match=message):
        pinred.BallStop(**arguments)


def test_kind_of_stop_must_fit_the_joint() -> None:
    """Balls have angles, and hinges have positions; attitudes start within their stops."""
    run: dict[str, Any] = {"duration": 0.1, "xdot0": [0.1, 0.0, 0.0]}
    with pytest.raises(pinred.InputError, match="expected a BallStop for ball joint 'joint'"):
        pinred.simulate(spheres(), **run, stops={"joint": (-1.0, 1.0)})
    cat = pinred.load("falling_cat")
    with pytest.raises(pinred.InputError, match="expected a Stop for joint 'bend'"):
        pinred.simulate(cat, duration=0.1, stops={"bend": pinred.BallStop(angle=1.0)})
    with pytest.raises(pinred.InputError, match=r"'joint' is 0\.2 beyond its angle stop \(0\.5"):
        pinred.simulate(
            spheres(), **run, x0={"joint": [0.7, 0.0, 0.0]},
            stops={"joint": pinred.BallStop(angle=0.5)},
        )  # fmt: skip


def test_scene_file_takes_stops_of_balls(tmp_path: Path) -> None:
    """A table of a ball has other keys than that of a hinge."""
    (tmp_path / "robot.xml").write_text(
        '<mujoco><option gravity="0 0 0"/><worldbody><body name="base"><freejoint/>'
        '<inertial pos="0 0 0" mass="1" diaginertia=".01 .02 .02"/>'
        '<body name="arm" pos="0.2 0 0"><joint type="ball" name="neck"/>'
        '<inertial pos="0.1 0 0" mass="0.3" diaginertia=".001 .001 .001"/>'
        "</body></body></worldbody></mujoco>"
    )
    file = tmp_path / "scene.toml"
    file.write_text(
        'robot = "robot.xml"\n[start]\nx0 = {neck = [0.0, 0.0, 0.0]}\n'
        "xdot0 = [1.0, 2.0, -1.0]\n[run]\nduration = 0.6\n"
        "[stops]\nneck = {swing = 0.4, twist = [-0.2, 0.3], axis = [1, 0, 0], restitution = 0.5}\n"
    )
    traj = pinred.simulate(pinred.load_scene(file))
    assert len(traj.impacts) >= 1
    file.write_text(file.read_text().replace("swing", "lower"))
    with pytest.raises(pinred.InputError, match=r"stops.*expected lower of a hinge"):
        pinred.load_scene(file)


@pytest.mark.parametrize("bounded", [False, True])
def test_stops_of_file_bound_the_angles_of_balls(tmp_path: Path, bounded: bool) -> None:
    """The range of a ball in an MJCF file is a stop without restitution, as MuJoCo reads it."""
    limits = 'limited="true" range="0 0.5"' if bounded else ""
    text = f"""<mujoco><compiler angle="radian"/><default><geom contype="0" conaffinity="0"/>
    </default><worldbody>
    <body name="base"><freejoint/><geom size="0.2" mass="1"/>
    <body name="arm" pos="0 0 0.3"><joint name="neck" type="ball" {limits}/>
    <geom size="0.1" mass="0.5"/><body name="tip" pos="0 0 0.4">
    <joint name="elbow" axis="0 1 0" limited="true" range="-0.2 0.2"/>
    <geom size="0.1" mass="0.5" pos="0 0 0.2"/></body></body></body></worldbody></mujoco>"""
    (tmp_path / "robot.xml").write_text(text, "utf-8")
    robot = pinred.load(tmp_path / "robot.xml", gravity=(0, 0, 0))
    traj = pinred.simulate(
        robot, xdot0=[1.0, 0.0, 0.0, 1.0], momentum=0, duration=1.0, stops="file"
    )
    assert set(traj.impacts.joint) == {"elbow", *(["neck"] if bounded else [])}
    angles = 2.0 * np.arctan2(np.linalg.norm(traj.x[:, :3], axis=1), np.abs(traj.x[:, 3]))
    assert (angles.max() < 0.5 + 1e-12) == bounded
    assert angles.max() > 0.5 - 1e-6
