"""Swimmers, wheels, other base links and floating arms with ball joints, against Pinocchio."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred.common.arrays import Array
from pinred.lie.rotations import hat

ROOTS = {"SE3": pin.JointModelFreeFlyer, "SE2": pin.JointModelPlanar}
ROD = pinred.Rod(0.4, 2.0, 1.0, centre=(0.1, 0.0, 0.2), axis=(0.0, 1.0, 1.0))


def robot(group: str) -> pinred.System:
    """Return a base with a hinge and a ball behind it, and frames of their links."""
    model = pin.Model()
    model.name = f"robot in {group}"
    model.gravity.setZero()
    joints = [
        (ROOTS[group](), "base", (0.0, 0.0, 0.0)),
        (pin.JointModelRZ(), "hinge", (0.3, 0.1, 0.2)),
        (pin.JointModelSpherical(), "ball", (0.2, -0.1, 0.3)),
    ]
    for i, (joint, name, place) in enumerate(joints):
        at = pin.SE3(pin.exp3(np.array(place)) if i else np.eye(3), np.array(place))
        model.addJoint(i, joint, at, name)
        body = pin.Inertia(1.0 + 0.3 * i, np.array([0.1, 0.05 * i, 0.2]), np.diag([0.3, 0.4, 0.5]))
        model.appendBodyToJoint(i + 1, body, pin.SE3.Identity())
        model.addBodyFrame(f"{name}_link", i + 1, pin.SE3.Identity(), 0)
    return pinred.load(model)


def shape_of(system: pinred.System, seed: int = 0) -> Array:
    """Return a random shape."""
    return system.space.random(np.random.default_rng(seed), 1.5)


def jacobian(system: pinred.System, x: Array, joint: int) -> Array:
    """Return Pinocchio's Jacobian of a joint's frame in its own axes, (6, n)."""
    model, data = system.model, system.model.createData()
    pin.computeJointJacobians(model, data, system.q(system.group.identity(), x))
    return np.array(pin.getJointJacobian(model, data, joint, pin.LOCAL))


def check_local_and_curvature(
    A: pinred.Connection, expected: Callable[[Array], Array], x: Array
) -> None:
    """Compare A with an independent function, and B with its differences along the frame."""
    space, group, h = A.space, A.group, 1e-3
    local = expected(x)
    np.testing.assert_allclose(A.local(x), local, atol=1e-11)
    slopes = np.zeros((A.r, A.m, A.m))  # e_α A_β with α last
    for k in range(A.m):
        for step, weight in ((1, 8.0), (-1, -8.0), (2, -1.0), (-2, 1.0)):
            moved = expected(space.integrate(x, step * h * np.eye(A.m)[k]))
            slopes[..., k] += weight / (12.0 * h) * moved
    exterior = np.swapaxes(slopes, 1, 2) - slopes
    brackets = np.einsum("aij,jb->iab", group.ad(local.T), local)
    turned = np.einsum("rg,gab->rab", local, space.structure)
    np.testing.assert_allclose(A.curvature(x), exterior - brackets - turned, atol=1e-8)


def test_swimmer_with_ball_equals_drag_by_pinocchio() -> None:
    """A = (Σ J_bᵀ D J_b)⁻¹ Σ J_bᵀ D J_s with Pinocchio's Jacobians, and the curvature of A."""
    system, D = robot("SE3"), 0.3 * np.eye(6)

    def local(x: Array) -> Array:
        J = [jacobian(system, x, i + 1) for i in range(3)]
        G = J[0].T @ ROD.tensor @ J[0] + J[2].T @ ROD.tensor @ J[2] + J[1].T @ D @ J[1]
        return np.asarray(np.linalg.solve(G[:6, :6], G[:6, 6:]))

    drag: dict[str, Any] = {"base_link": ROD, "hinge_link": D, "ball_link": ROD}
    A, x = pinred.Connection.viscous(system, drag), shape_of(system)
    check_local_and_curvature(A, local, x)
    fluid = pinred.Connection.fluid(system, 1e-9, {"ball_link": np.eye(6)})
    mechanical = pinred.Connection.mechanical(system)
    np.testing.assert_allclose(fluid.local(x), mechanical.local(x), atol=1e-7)


WHEELS = [
    pinred.Wheel("base_link", (0.1, 0.2, 0.0)),
    pinred.Wheel("hinge_link", (0.3, 0.0, 0.0), (0.2, 1.0, 0.0)),
    pinred.Wheel("ball_link", (0.1, 0.2, 0.3), (0.5, 0.3, 0.6)),
]


def constraints(system: pinred.System, x: Array, wheels: list[pinred.Wheel]) -> Array:
    """Return the rows of the slip speeds, (k, n), with Pinocchio's Jacobians."""
    rows = []
    for wheel in wheels:
        J = jacobian(system, x, system.model.getJointId(wheel.link.removesuffix("_link")))
        axle = np.array(wheel.axle) / np.linalg.norm(wheel.axle)
        rows.append(axle @ (J[:3] - hat(np.array(wheel.at)) @ J[3:]))
    return np.array(rows)


def test_wheel_on_ball_constrains_base() -> None:
    """A = W_b⁻¹ W_s with a wheel on the child of a ball; the axes of a ball carry no wheel."""
    system = robot("SE2")

    def local(x: Array) -> Array:
        W = constraints(system, x, WHEELS)
        return np.asarray(np.linalg.solve(W[:, :3], W[:, 3:]))

    check_local_and_curvature(pinred.Connection.kinematic(system, WHEELS), local, shape_of(system))
    rolling = pinred.Rolling("ball.x", 0.1, "base_link")
    with pytest.raises(pinred.InputError, match=r"'ball.x' is an axis of a ball joint"):
        pinred.Connection.kinematic(system, [*WHEELS[:2], rolling])


def test_mixed_motion_with_ball_equals_multipliers_by_pinocchio() -> None:
    """Accelerations of the joints from Pinocchio's H v̇ = τ − c + Wᵀλ, W v̇ = −Ẇ v."""
    system = robot("SE2")
    wheels = [WHEELS[0], WHEELS[2]]
    A, rng = pinred.mixed_connection(system, wheels), np.random.default_rng(1)
    x0, xdot0, tau = shape_of(system), 0.5 * rng.normal(size=4), rng.normal(size=4)
    h = 1e-3
    times = h * np.arange(5)
    motion = pinred.simulate_mixed(A, x0, xdot0, [0.4], times=times, torques=lambda _: tau)
    slope = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / (12.0 * h)
    x, v = motion.x, [
        np.concatenate([A.velocity(*row), row[1]])
        for row in zip(motion.x, motion.xdot, motion.p, strict=True)
    ]  # fmt: skip
    W = [constraints(system, row, wheels) for row in x]
    model, data = system.model, system.model.createData()
    q = system.q(system.group.identity(), x[2])
    H = np.triu(pin.crba(model, data, q))
    H = H + np.triu(H, 1).T
    right = np.concatenate([np.zeros(3), tau]) - pin.nonLinearEffects(model, data, q, v[2])
    Wdot = np.tensordot(slope, np.array(W), 1)
    KKT = np.block([[H, -W[2].T], [W[2], np.zeros((2, 2))]])
    expected = np.linalg.solve(KKT, np.concatenate([right, -Wdot @ v[2]]))[:7]
    np.testing.assert_allclose(np.tensordot(slope, np.array(v), 1), expected, atol=1e-8)
    free = pinred.simulate_mixed(A, x0, xdot0, [0.4], times=np.linspace(0.0, 1.0, 3))
    np.testing.assert_allclose(free.energy, free.energy[0], rtol=1e-11)
    np.testing.assert_allclose(np.linalg.norm(free.x[:, 1:], axis=1), 1.0, atol=1e-15)


def test_mixed_motion_follows_gait_of_ball() -> None:
    """Without momentum the base moves as the connection lifts the gait in rotation vectors."""
    system = robot("SE2")
    A = pinred.mixed_connection(system, [WHEELS[0], WHEELS[2]])
    gait = pinred.Gait.fourier([0.1, 0.2, 0.3, 0.1], [[0.2, 0, 0.4, 0]], [[0, 0.3, 0, 0.5]])
    motion = pinred.follow_mixed(A, gait, 0.3, times=np.linspace(0.0, gait.period, 5))
    momenta = [
        A.momentum(x, xdot, A.velocity(x, xdot, p))
        for x, xdot, p in zip(motion.x, motion.xdot, motion.p, strict=True)
    ]
    np.testing.assert_allclose(momenta, motion.p, atol=1e-11)
    w, _ = gait.at(motion.t)
    np.testing.assert_allclose(
        motion.x[:, 1:], system.space.integrate(system.space.neutral, w)[:, 1:], atol=1e-14
    )


def test_phase_seen_from_child_of_ball_is_conjugate() -> None:
    """A loop moves the child by h⁻¹ g h, with Pinocchio's pose h of the child."""
    system = robot("SE3")
    A, G = pinred.Connection.mechanical(system), system.group
    B = A.seen_from("ball_link")
    gait = pinred.Gait.fourier([0.1, 0.2, 0.3, 0.1], [[0.2, 0, 0.4, 0]], [[0, 0.3, 0, 0.5]])
    p, q = (pinred.phase(connection, gait, tolerance=1e-12) for connection in (A, B))
    model, data = system.model, system.model.createData()
    x = system.space.integrate(system.space.neutral, gait.at(0.0)[0])
    pin.forwardKinematics(model, data, system.q(G.identity(), x))
    h = pin.SE3ToXYZQUAT(data.oMi[3])
    expected = G.compose(G.inverse(h), G.compose(p.pose, h))
    assert G.error(q.pose, expected).rotation <= 1e-11
    assert G.error(q.pose, expected).translation <= 1e-11


def test_generalised_jacobian_with_ball_moves_hand() -> None:
    """J_g and its rate against differences of hand poses on horizontal motions."""
    system = robot("SE3")
    arm, A = pinred.FloatingArm(system, "ball_link"), pinred.Connection.mechanical(system)
    x, sigma, h = shape_of(system), np.array([0.4, -0.3, 0.6, 0.2]), 1e-4
    J, G = arm.generalized_jacobian(x), system.group
    for k in range(system.m):
        hands = []
        for step in (-h, h):
            direction = np.eye(system.m)[k] * step
            middle = system.space.integrate(x, 0.5 * direction)
            pose = G.exp(-A.local(middle) @ direction)
            hands.append(arm.hand_pose(system.space.integrate(x, direction), pose=pose))
        start = arm.hand_pose(x)
        moved = [pin.log6(start.actInv(hand)).vector for hand in hands]
        np.testing.assert_allclose((moved[1] - moved[0]) / (2 * h), J[:, k], atol=1e-7)
    ahead, behind = (
        arm.generalized_jacobian(system.space.integrate(x, s * h * sigma)) for s in (1.0, -1.0)
    )
    np.testing.assert_allclose(arm.rate(x, sigma), (ahead - behind) / (2 * h), atol=1e-7)


def test_singular_attitudes_of_ball_have_zero_determinant() -> None:
    """About an axis of the ball, and along a rotation about one axis."""
    system = robot("SE3")
    arm = pinred.FloatingArm(system, "ball_link", task=(0, 1, 2, 3))
    x = shape_of(system)
    values = arm.singular_values_of("ball.y", x)
    assert len(values)
    for value in values:
        at = system.space.integrate(x, value * np.eye(4)[2])
        size = np.abs(arm.generalized_jacobian(at)[:4]).max() ** 4
        assert abs(arm.singularity(at).determinant) <= 1e-10 * size
    end = system.space.integrate(x, np.array([0.0, 0.0, 3.0, 0.0]))
    forward = values[(values >= 0.0) & (values <= 3.0)] / 3.0
    np.testing.assert_allclose(arm.singular_along(x, end), forward, atol=1e-9)
    assert arm.workspace(samples=3).reach[0] >= 0.0
