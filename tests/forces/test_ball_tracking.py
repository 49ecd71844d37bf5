"""PD control and computed torque of balls, and forces that see base and balls at once."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from ball_trees import ball_tree
from forced_trees import against_aba

import pinred
from pinred import InputError
from pinred.common.arrays import Array
from pinred.forces import PD, BallPD, BallSpring, ComputedTorque, Limit, SeenState, Torque, Wrench
from pinred.lie.rotations import conjugate, quaternion_exp, quaternion_product, rotation
from pinred.scene.scene import ENGINES, Engine
from pinred.signals import Attitude, Expression, Spline

MOVING = Attitude(["0.4*sin(2*t)", "0.3*cos(t)", "0.2*t"], [0.1, 0.2, 0.3])
OPTIONS: dict[str, Any] = {"seed": 2, "duration": 0.4, "rtol": 1e-9, "atol": 1e-11}


def errors_of(q: Array, attitude: Attitude, t: Array) -> Array:
    """Return log(R_dᵀ R), (n, 3), by Pinocchio's logarithm."""
    E = quaternion_product(conjugate(attitude.value(t)), q)
    return np.array([pin.log3(rotation(e)) for e in E])


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.sampled
def test_computed_torque_of_balls_obeys_closed_form(engine: Engine) -> None:
    """An error that begins along one axis n stays along it: log E = θ n, θ̈ + kd θ̇ + kp θ = 0.

    The reference moves, springs are compensated, and one ball is prescribed.
    """
    system = pinred.load("diver")
    driven, moving, fixed = (joint.name for joint in system.space.balls)
    plan: dict[str, Any] = {moving: MOVING, fixed: [0.3, -0.1, 0.2]}
    n = np.array([2.0, -1.0, 2.0]) / 3.0
    E = quaternion_exp(0.5 * n)
    start = quaternion_product(MOVING.value(0.0), E)
    follow = rotation(E).T @ MOVING.rate(0.0)
    traj = pinred.simulate(
        system, duration=0.4, engine=engine, rtol=1e-11, atol=1e-13,
        x0={moving: start, fixed: [0.3, -0.1, 0.2]},
        xdot0={f"{moving}.{a}": v for a, v in zip("xyz", follow - 0.8 * n, strict=True)},
        prescribed={driven: Attitude([0.0, Expression("0.2*sin(t)"), 0.0])},
        momentum=[0, 0, 0, 1, 5, 2],
        forces=[ComputedTorque(plan, {moving: 9.0, fixed: 4.0}, 10.0), BallSpring(moving, 3.0)],
    )  # fmt: skip
    ball = next(joint for joint in system.space.balls if joint.name == moving)
    a, b = -1.0, -9.0  # roots of s² + 10 s + 9
    A = (-0.8 - b * 0.5) / (a - b)
    theta = A * np.exp(a * traj.t) + (0.5 - A) * np.exp(b * traj.t)
    found = errors_of(traj.x[:, ball.x], MOVING, traj.t)
    np.testing.assert_allclose(found, np.outer(theta, n), atol=1e-9)
    rest = next(joint for joint in system.space.balls if joint.name == fixed)
    still = np.tile(quaternion_exp(np.array([0.3, -0.1, 0.2])), (len(traj.t), 1))
    np.testing.assert_allclose(np.abs(np.sum(traj.x[:, rest.x] * still, axis=1)), 1.0, atol=1e-12)


def test_pd_of_ball_equals_ball_pd_and_judge_passes() -> None:
    """Gains and limits are given for whole balls; hinges and balls share one controller."""
    system = ball_tree(1, 3, balls=0.3)
    hinges = [j.name for j in system.space.joints if not j.kind.is_ball]
    balls = [j.name for j in system.space.balls]
    assert hinges
    kp = {**dict.fromkeys(hinges, 4.0), **dict.fromkeys(balls, 3.0)}
    reference: dict[str, Any] = {
        **dict.fromkeys(hinges, Expression("0.1*sin(t)")),
        **dict.fromkeys(balls, MOVING),
    }
    single = [BallPD(name, MOVING, 3.0, 0.7, Limit({name: 2.0}), name=name) for name in balls]
    of_hinges = PD({name: reference[name] for name in hinges}, 4.0, 0.7)
    limits = Limit({**dict.fromkeys(hinges, 1e9), **dict.fromkeys(balls, 2.0)})
    together = pinred.simulate(system, forces=[PD(reference, kp, 0.7, limits)], **OPTIONS)
    apart = pinred.simulate(system, forces=[*single, of_hinges], **OPTIONS)
    np.testing.assert_allclose(together.x, apart.x, atol=1e-8)
    assert pinred.compare(together).passed


# The closed form above confirms the law for balls, test_controllers.py for hinges and slides.
@pytest.mark.by_hand
def test_computed_torque_passes_judge() -> None:
    """Random trees of balls, hinges and slides, with a base that moves freely."""
    system = ball_tree(5, 2, balls=0.0)
    reference = {j.name: MOVING if j.kind.is_ball else 0.1 for j in system.space.joints}
    force = ComputedTorque(reference, 9.0, 6.0)
    report = pinred.compare(pinred.simulate(system, forces=[force], **OPTIONS))
    assert report.passed, str(report)


@pytest.mark.parametrize("axes", ["body", "world"])
@pytest.mark.sampled
def test_wrench_and_torque_that_see_base_and_balls_equal_aba(axes: Any) -> None:
    """A wrench on a link behind balls, and torques of quaternions of base and balls."""
    bare = ball_tree(7, 4).model
    bare.addFrame(pin.Frame("hand", bare.njoints - 1, pin.SE3.Random(), pin.FrameType.BODY))
    system = pinred.load(bare)
    model, data, point = system.sorted_model, system.sorted_model.createData(), [0.1, -0.2, 0.3]
    frame, balls = model.getBodyId("hand"), system.space.balls
    rng = np.random.default_rng(1)
    on_base, on_balls = rng.normal(size=(system.m, 9)), rng.normal(size=(system.m, len(balls)))

    def load(s: SeenState) -> list[Any]:
        return [1.0, ca.sin(3.0 * s.t), -0.5 * s.pose[3] * s.pose[6], 0.2, 0.1 * s.xi[5], 0.3]

    def squares(q: Any) -> list[Any]:
        return [q[i] * q[j] for i in range(4) for j in range(i, 4)][:9]  # of ±q they are the same

    def torque(s: SeenState) -> Any:
        of_balls = ca.vertcat(*(s.x[b.x][0] * s.x[b.x][3] for b in balls))
        return 0.3 * ca.tanh(
            ca.DM(on_base) @ ca.vertcat(*squares(s.pose[3:])) + ca.DM(on_balls) @ of_balls
        )

    forces = [Wrench(load, link="hand", at=point, frame=axes), Torque(torque)]
    traj = pinred.simulate(system, forces=forces, **OPTIONS)
    turn = model.jointPlacements[1].rotation

    def tau(t: float, q: Array, v: Array) -> Any:
        x = system.configuration(q).x
        F = np.array([1.0, np.sin(3.0 * t), -0.5 * q[3] * q[6], 0.2, 0.1 * v[5], 0.3])
        pin.framesForwardKinematics(model, data, q)
        R = data.oMf[frame].rotation
        world = R if axes == "body" else turn
        force, moment = world @ F[:3], world @ F[3:]
        J = pin.computeFrameJacobian(model, data, q, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        of_balls = np.array([x[b.x][0] * x[b.x][3] for b in balls])
        inner = 0.3 * np.tanh(on_base @ np.array(squares(q[3:7])) + on_balls @ of_balls)
        carried = J.T @ np.append(force, moment + np.cross(R @ point, force))
        return np.asarray(carried) + np.append(np.zeros(6), inner)

    assert against_aba(traj, tau) < 1e-6


# Flows with balls are differentiated in test_prescribed_balls.py.
@pytest.mark.by_hand
def test_flow_differentiates_forces_that_see_base_and_balls() -> None:
    """The Jacobian agrees with differences of simulations."""
    system = ball_tree(11, 2)
    forces = [
        Torque(lambda s: {"j0.x": 0.5 * s.pose[3] * s.x[1], "j0.y": 0.3 * s.xi[4] * s.x[3]}),
        PD({"j0": MOVING}, 3.0, 0.5),
    ]
    options: dict[str, Any] = {"seed": 4, "duration": 0.3, "rtol": 1e-11, "atol": 1e-13}
    scene = pinred.Scene(system=system, forces=forces, **options)
    columns = pinred.flow(scene, wrt=["xdot0"]).columns()
    xdot0 = scene.start.xdot
    (J,) = columns.jacobian(xdot0)
    d = 1e-4
    for k in range(system.m):
        step = d * np.eye(system.m)[k]
        slope = (columns.value(xdot0 + step) - columns.value(xdot0 - step)) / (2.0 * d)
        np.testing.assert_allclose(J[:, k], slope, atol=2e-6)


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        ({"j0": 0.3}, r"'j0'\] is a ball joint: expected an Attitude"),
        ({"j0.x": 0.3}, "axis of a ball joint, along which there is no coordinate"),
        ({"j0": [0.1, 0.2]}, "expected three signals"),
        ({"nope": MOVING}, "no ball joint 'nope'; the ball joints are"),
        ({"j0": [0.0, 0.0, 0.0, 0.0]}, "zero"),
    ],
)
def test_references_of_wrong_kind_are_refused(reference: Any, message: str) -> None:
    """The message names the ball and what is expected."""
    with pytest.raises(InputError, match=message):
        pinred.simulate(ball_tree(3, 2), seed=0, duration=0.1, forces=[PD(reference, 1.0, 1.0)])


@pytest.mark.parametrize("force", [PD, ComputedTorque, BallPD])
def test_references_that_jump_are_refused(force: Any) -> None:
    """A rotation vector jumps where a logarithm was not unwrapped; the message names the ball."""
    jumping = Attitude([Spline([0.0, 0.5, 1.0], [0.0, 2.5, -2.5]), 0.0, 0.0])
    with pytest.raises(InputError, match=r"jumps by 5 rad from t = 0.5 s to 1 s"):
        force("neck", jumping, 1.0, 1.0) if force is BallPD else force({"neck": jumping}, 1.0, 1.0)
