"""Stops of ball joints: angle, swing and twist, against closed forms and rotation matrices."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from ball_trees import ball_tree, joined_bodies
from hybrid_reference import HybridReference, stops_of
from trees import random_model

import pinred
from pinred.cli.command_options import stop_in
from pinred.common.arrays import Array
from pinred.common.errors import IntegrationError
from pinred.forces import ComputedTorque, Torque
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


@pytest.mark.parametrize(
    "kinds", [*((kind,) for kind in KINDS), KINDS[:2], KINDS[1:], (KINDS[0], KINDS[2])]
)
def test_place_turns_a_ball_to_one_or_two_stops(kinds: tuple[str, ...]) -> None:
    """The bounded angles of rotation matrices have their limits, and the turn is small."""
    rng = np.random.default_rng(2)
    for _ in range(20):
        stop = pinred.BallStop(swing=1.0, axis=tuple(rng.normal(size=3)))
        q, n = rng.normal(size=4), np.array(stop.axis)
        q /= np.linalg.norm(q)
        bounds = [BallBound("ball", 0, 0, 1.0, 0.0, 1.0, stop, kind) for kind in kinds]
        limits = [float(bound.values(q)) + 1e-6 for bound in bounds]
        bounds = [replace(b, position=limit) for b, limit in zip(bounds, limits, strict=True)]
        moved = q.copy()
        place(bounds, moved)
        R = pin.Quaternion(moved).toRotationMatrix()
        found = [angle_by_matrices(kind, R, n) for kind in kinds]
        np.testing.assert_allclose(found, limits, rtol=0.0, atol=1e-8)
        assert np.abs(moved - q).max() < 1e-3


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


@pytest.mark.by_hand("axial")
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


def test_rebounds_of_a_ball_accumulate_at_the_time_of_the_closed_form() -> None:
    """A torque of 1 N·m turns the spheres about one axis, with the acceleration 1/0.08 rad/s²."""
    e, speed, limit, pull = 0.3, 2.0, 0.5, 1.0 / 0.08
    traj = pinred.simulate(
        spheres(), xdot0=[speed, 0.0, 0.0], duration=1.0, rtol=1e-11,
        forces=[Torque(lambda *_: [1.0, 0.0, 0.0])],
        stops={"joint": pinred.BallStop(angle=limit, restitution=e, rest_rate=1e-7)},
    )  # fmt: skip
    first = float(np.sqrt(speed**2 + 2.0 * pull * limit))
    hit = (first - speed) / pull
    (_, _), (rest, label) = traj.motion.modes
    assert label == "joint at its angle stop"
    np.testing.assert_allclose(rest, hit + 2.0 * first * e / (pull * (1.0 - e)), atol=1e-7)
    rates = traj.impacts.rate_before
    np.testing.assert_allclose(rates[:8], first * e ** np.arange(8), rtol=1e-7)
    np.testing.assert_allclose(traj.stop_reactions[-1], [-1.0, 0.0, 0.0], atol=1e-9)
    lost = 0.5 * 0.08 * speed**2 + limit  # kinetic energy, and work of the torque
    np.testing.assert_allclose(traj.impacts.energy_lost.sum(), lost, rtol=1e-9)


def rotation(axis: Array, angle: float) -> Array:
    """Return a rotation matrix."""
    return np.array(pin.exp3(axis * angle))


# `test_stops_in_both_engines.py` compares a ball's motion in both engines.
@pytest.mark.by_hand("pinocchio")
@pytest.mark.parametrize("engine", ["compiled", "pinocchio"])
def test_precession_on_a_cone_has_the_closed_form(engine: Any) -> None:
    """A sphere and a symmetric body turn about their momentum J, and each about its own axis.

    Their rates are Ω J + β n and Ω J + γ c, with the axes n and c at the angle s of the cone, and J
    at the angle A from n in their plane.  The sphere of inertia a has the momentum a (Ω J + β n),
    which changes by a β Ω J × n, the reaction.  A steady motion needs k J = a β n + b c, where b is
    the momentum of the body beyond I₁ Ω J along its axis, and k J = |J| J − (a + I₁) Ω J.
    """
    a, first, third, s, A, omega, k = 0.4, 0.1, 0.15, 0.5, 0.2, 1.3, -0.6
    n, c, J = (np.array([np.sin(u), 0.0, np.cos(u)]) for u in (0.0, s, A))
    beta = k * np.sin(s - A) / np.sin(s) / a
    gamma = (k * np.sin(A) / np.sin(s) - (third - first) * omega * np.cos(s - A)) / third
    tilt = rotation(np.array([0.0, 1.0, 0.0]), s)
    traj = pinred.simulate(
        joined_bodies(np.array([[a, a, a], [first, first, third]]), np.zeros((2, 3))),
        x0={"joint": pin.log3(tilt)}, xdot0=tilt.T @ (gamma * c - beta * n),
        xi0=[0.0, 0.0, 0.0, *(omega * J + beta * n)], duration=2.0, rtol=1e-11, engine=engine,
        stops={"joint": pinred.BallStop(swing=s, restitution=0.0)},
    )  # fmt: skip
    assert traj.motion.modes == ((0.0, "joint at its swing stop"),)
    assert len(traj.impacts) == 0
    (bound,) = traj.scene.bounds
    np.testing.assert_allclose(bound.values(traj.x), s, rtol=0.0, atol=2e-15)
    for t, q in zip(traj.t, traj.q, strict=True):
        base = rotation(J, omega * t) @ rotation(n, beta * t)
        child = rotation(J, omega * t) @ rotation(c, gamma * t) @ tilt
        for quaternion, R in ((q[3:7], base), (q[7:], base.T @ child)):
            found = pin.Quaternion(quaternion).toRotationMatrix()
            np.testing.assert_allclose(found, R, rtol=0.0, atol=1e-9)
    size = np.linalg.norm(traj.stop_reactions, axis=1)
    np.testing.assert_allclose(size, abs(a * beta * omega * np.sin(A)), rtol=1e-9)


REST: dict[str, Any] = {
    "swing": {"swing": 0.5},
    "angle": {"angle": 0.6},
    "twist": {"twist": (-0.3, 0.3)},
    "angle, swing and twist": {"angle": 0.55, "swing": 0.4, "twist": (-0.5, 0.5), "axis": AXIS},
}


def resting(kind: str, **options: Any) -> pinred.Trajectory:
    """Return a motion of two bodies whose ball rests at its stops."""
    run: dict[str, Any] = {
        "xdot0": [2.0, -1.0, 1.5], "xi0": [0.1, 0.2, 0.3, 0.4, -0.2, 0.5], "duration": 2.0,
        "stops": {"joint": pinred.BallStop(**REST[kind], restitution=0.0)},
    }  # fmt: skip
    return pinred.simulate(joined_bodies(), **run | options)


# All stops at once contain each.
@pytest.mark.by_hand("swing", "twist", "angle")
@pytest.mark.parametrize("kind", REST)
def test_balls_at_rest_agree_with_full_state_dynamics(kind: str) -> None:
    """The full state obeys pin.aba with multipliers of tr(W R) ≥ c, which is another formula."""
    traj = resting(kind, rtol=1e-12, atol=1e-14)
    reference = HybridReference(traj.system, stops_of(traj), tolerance=3e-13)
    motion = reference.run(traj.q[0], traj.v[0], {}, traj.t)
    assert len(motion.modes) > 1
    assert len(traj.impacts) == len(motion.hits)
    hits, modes = [hit.t for hit in motion.hits], [t for t, _ in motion.modes]
    np.testing.assert_allclose(traj.impacts.t, hits, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose([t for t, _ in traj.motion.modes], modes, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(traj.q, motion.q, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(traj.v, motion.v, rtol=0.0, atol=1e-9)
    lost = sum(hit.lost for hit in motion.hits)
    np.testing.assert_allclose(traj.impacts.energy_lost.sum(), lost, rtol=1e-9)


# Balls at rest agree with full-state dynamics, above.
@pytest.mark.by_hand
@pytest.mark.parametrize(
    "kind",
    [
        "swing",
        pytest.param("angle", marks=pytest.mark.by_hand),
        pytest.param("twist", marks=pytest.mark.by_hand),
        pytest.param("angle, swing and twist", marks=pytest.mark.by_hand),
    ],
)
def test_balls_at_rest_pass_the_comparison_and_stay_on_their_stops(kind: str) -> None:
    """Gaps and momentum are exact at loose tolerances, too; the momentum is that of Pinocchio."""
    traj = resting(kind, rtol=1e-5, times=np.linspace(0.0, 2.0, 101))
    count = 0
    for rest, rows in traj.motion.resting(traj.t):
        for bound in rest:
            gaps = bound.values(traj.x[rows]) - bound.position
            np.testing.assert_allclose(gaps, 0.0, atol=2e-15)
            count += len(rows)
    assert count > 20
    momentum = full_momentum(traj)
    terms = np.abs(momentum).max()
    np.testing.assert_allclose(momentum - momentum[0], 0.0, atol=1e-13 * terms)
    report = pinred.compare(traj)
    assert report.verdict is Verdict.PASSED, report


def full_momentum(traj: pinred.Trajectory) -> Array:
    """Return the sum of the momenta of both bodies about the origin, by Pinocchio, (T, 6)."""
    model, rows = traj.system.model, []
    data = model.createData()
    for q, v in zip(traj.q, traj.v, strict=True):
        pin.forwardKinematics(model, data, q, v)
        total = pin.Force.Zero()
        for k in range(1, model.njoints):
            total += data.oMi[k].act(model.inertias[k] * data.v[k])
        rows.append(total.vector)
    return np.array(rows)


def test_reactions_of_balls_and_torques_keep_the_balance_of_energy() -> None:
    """A torque presses the ball to its stop, whose reaction does no work."""
    traj = resting(
        "swing", forces=[Torque(lambda *state: [3.0 * state[1][1], -2.0 * state[1][0], 0.1])],
        rtol=1e-10,
    )  # fmt: skip
    assert len(traj.motion.modes) > 1
    assert np.abs(traj.stop_reactions).max() > 0.1
    np.testing.assert_allclose(traj.energy_balance.residual, 0.0, atol=1e-8)


def test_computed_torque_presses_a_ball_against_its_stop() -> None:
    """The law does not know of the stop; without a stop it would turn the ball beyond it."""
    traj = resting("swing", forces=[ComputedTorque({"joint": [0.6, 0.5, 0.2]}, kp=4.0, kd=2.0)])
    assert traj.motion.modes[-1][1] == "joint at its swing stop"
    report = pinred.compare(traj)
    assert report.verdict is Verdict.PASSED, report


def test_symmetric_balls_rest_at_their_stops() -> None:
    """A rotor has a constant momentum until the reaction of its stop changes it."""
    system = joined_bodies(np.array([[0.4, 0.5, 0.7], [0.1, 0.1, 0.1]]), np.zeros((2, 3)))
    traj = pinred.simulate(
        system, xdot0=[2.0, -1.0, 1.5], xi0=[0.1, 0.2, 0.3, 0.4, -0.2, 0.5], duration=1.0,
        stops={"joint": pinred.BallStop(swing=0.5, restitution=0.0)}, rtol=1e-8, atol=1e-10,
    )  # fmt: skip
    assert len(traj.motion.modes) >= 2
    report = pinred.compare(traj)
    assert report.verdict is Verdict.PASSED, report


def test_files_and_members_have_the_impacts_of_balls_at_rest(tmp_path: Path) -> None:
    """A file returns the table; members have the bits of single runs."""
    traj = resting("swing")
    traj.save(tmp_path / "motion.npz")
    loaded = pinred.read_recording(tmp_path / "motion.npz")
    np.testing.assert_array_equal(loaded.impacts.impulse, traj.impacts.impulse)
    assert loaded.impacts.side == traj.impacts.side
    many = pinred.simulate_many(
        joined_bodies(), members={"xdot0": np.array([[2.0, -1.0, 1.5], [1.0, 1.0, 0.5]])},
        xi0=[0.1, 0.2, 0.3, 0.4, -0.2, 0.5], duration=2.0,
        stops={"joint": pinred.BallStop(**REST["swing"], restitution=0.0)},
    )  # fmt: skip
    np.testing.assert_array_equal(many.impacts.of_member(0).t, resting("swing").impacts.t)


def test_swing_of_a_ball_at_its_twist_stop_must_not_reach_half_a_turn() -> None:
    """There, the twist is not defined, and the stop would push to the other side.

    The spheres turn about one axis across that of the twist, with π rad/s.  A torque along the
    gradient of v·n cos(twist/2) − w sin(twist/2) presses the ball to its stop.
    """
    twist = 0.3
    c, s = np.cos(0.5 * twist), np.sin(0.5 * twist)

    def press(_: Any, q: Any, *rest: Any) -> list[Any]:  # noqa: ARG001
        return [s * q[0] - c * q[1], s * q[1] + c * q[0], s * q[2] + c * q[3]]

    with pytest.raises(IntegrationError, match=r"swing of ball joint 'joint' reaches π at t = 1 s"):
        pinred.simulate(
            spheres(), x0={"joint": [0.0, 0.0, twist]}, duration=2.0,
            xdot0=rotation(np.array([0.0, 0.0, 1.0]), -twist) @ [np.pi, 0.0, 0.0],
            forces=[Torque(press)],
            stops={"joint": pinred.BallStop(twist=(-twist, twist), restitution=0.0)},
        )  # fmt: skip


def test_three_stops_of_one_ball_at_once_are_refused() -> None:
    """The angle is a function of swing and twist, so one of three reactions is not determined."""
    swing, twist = 0.4, 0.5
    angle = 2.0 * np.arccos(np.cos(0.5 * swing) * np.cos(0.5 * twist))
    attitude = rotation(np.array([1.0, 0.0, 0.0]), swing) @ rotation(
        np.array([0.0, 0.0, 1.0]), twist
    )
    with pytest.raises(IntegrationError, match="joint at its angle stop, joint at its swing stop"):
        pinred.simulate(
            spheres(), x0={"joint": pin.log3(attitude)}, duration=0.1,
            stops={
                "joint": pinred.BallStop(
                    angle=angle, swing=swing, twist=(-twist, twist), restitution=0.0
                )
            },
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
        ({"angle": 1.0, "restitution": -0.1}, "restitution: expected"),
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


@pytest.mark.parametrize(
    ("text", "stop"),
    [
        ("swing:0.5", pinred.BallStop(swing=0.5)),
        (
            "angle:1,twist:-0.4:0.3,axis:1:0:0,restitution:0.6,rest_rate:1e-5",
            pinred.BallStop(
                angle=1.0, twist=(-0.4, 0.3), axis=(1, 0, 0), restitution=0.6, rest_rate=1e-5
            ),
        ),
    ],
)
def test_command_line_states_the_fields_of_ball_stops(text: str, stop: pinred.BallStop) -> None:
    """Names and numbers are separated by colons."""
    assert stop_in(text) == stop


@pytest.mark.parametrize("text", ["swing:", "twist:0.4", "swing:1:2", "tilt:1", "swing:1,swing:2"])
def test_other_texts_of_ball_stops_are_refused(text: str) -> None:
    """A field is unknown, stated twice, or has another number of values."""
    with pytest.raises(ValueError, match=r"^$|float"):
        stop_in(text)


@pytest.mark.by_hand
def test_impacts_that_the_simulation_joins_cannot_be_judged() -> None:
    """In the corner of swing and twist, rebounds accumulate within rtol times the duration.

    The simulation takes them as one impact, whose impulses differ from those of many.
    """
    system, rng = ball_tree(2, 4, "SE2", armature=False), np.random.default_rng(2)
    stops: dict[str, Any] = {}
    for joint in system.space.joints:
        stops[joint.name] = (-0.3, 0.35)
        if joint.kind.is_ball:
            kind, axis, e = (
                rng.integers(0, 4),
                tuple(rng.normal(size=3)),
                rng.choice([0.0, 0.0, 0.5]),
            )
            limits: Any = {"swing": 0.45, "twist": (-0.4, 0.3)} if kind == 3 else {"swing": 0.4}
            stops[joint.name] = pinred.BallStop(**limits, axis=axis, restitution=float(e))
    traj = pinred.simulate(
        system, x0=system.space.neutral, xdot0=1.5 * rng.normal(size=system.m),
        xi0=0.5 * rng.normal(size=system.r), stops=stops, duration=0.5, rtol=1e-10, atol=1e-12,
    )  # fmt: skip
    assert (np.diff(traj.impacts.t) == 0.0).any()
    report = pinred.compare(traj)
    assert report.verdict is Verdict.CANNOT_TELL, report
