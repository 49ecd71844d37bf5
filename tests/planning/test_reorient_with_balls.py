"""Reorientation by ball joints, against simulations with a free base."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import pinred

SPEED, TORQUE = 1.5, 0.05  # limits at the spine [rad/s], [N m]


def test_cat_with_ball_reaches_target_within_limits_of_speed_and_torque() -> None:
    """Speeds and torques are those of the simulated motion, in the axes of the child."""
    cat, start = pinred.load("falling_cat_ball"), (0.3, -0.2, 0.4)
    plan = pinred.reorient(
        cat, [0.0, 0.25, -0.3], x0={"spine": start}, limits=2.0, speeds=SPEED, torques=TORQUE
    )
    assert plan.remaining <= 1e-13
    assert plan.missed <= 1e-11
    traj = plan.trajectory
    x0 = cat.space.integrate(cat.space.neutral, np.array(start))
    np.testing.assert_allclose(traj.x[[0, -1]], [x0, x0], atol=1e-12)
    speed, torque = np.abs(traj.xdot).max(), np.abs(traj.driving_torques).max()
    assert speed <= SPEED
    assert plan.margins["speeds"] == pytest.approx(SPEED - speed, abs=1e-4)
    assert plan.margins["torques"] == pytest.approx(TORQUE - torque, abs=1e-5)
    assert plan.margins["speeds"] == pytest.approx(0.0, abs=1e-5)


@pytest.mark.by_hand
def test_hinge_and_ball_turn_tumbling_base() -> None:
    """With momentum, the base passes through the target at the end."""
    model = pin.Model()
    model.gravity.setZero()
    model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "root")
    for i, joint in enumerate((pin.JointModelRX(), pin.JointModelSpherical())):
        place = pin.SE3(np.eye(3), np.array([0.3, 0.1, 0.2 * i]))
        model.addJoint(1, joint, place, ("hinge", "ball")[i])
    for i in range(1, 4):
        body = pin.Inertia(1.0, np.array([0.1, 0.3, 0.2 * i]), np.diag([0.2, 0.3, 0.35]))
        model.appendBodyToJoint(i, body, pin.SE3.Identity())
    system = pinred.load(model)
    plan = pinred.reorient(
        system, [0.2, 0.0, 0.1], momentum=[0.02, 0.0, 0.03], limits=2.0, cycles=1, duration=2.0,
        x0={"hinge": 0.3, "ball": (0.1, 0.2, 0.0)},
    )  # fmt: skip
    assert plan.remaining <= 1e-10
    assert plan.missed <= 1e-10
    np.testing.assert_allclose(plan.trajectory.xi[-1], plan.left, atol=1e-10)
