"""Joint stops together with PD control, computed torques and sampled controllers."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred.forces import PD, ComputedTorque, Controller, Torque
from pinred.forces.signals.signal import Expression
from pinred.judge.verdict import Verdict
from pinred.system.force_interface import SeenState

STOPS = {"bend": (-0.5, 0.5), "sway": (-0.3, 0.3, 0.5)}
COARSE: dict[str, Any] = {"rtol": 1e-8, "atol": 1e-10}  # for fast comparisons
BEND, SWAY = Expression("0.9*cos(3*t)"), Expression("0.4*sin(4*t)")


def push(state: SeenState) -> dict[str, float]:
    """Press one joint against its stop, and move another to and fro."""
    torque = -2.0 * (state.x["bend"] - 0.8) - 0.1 * state.xdot["bend"]
    return {"bend": torque, "sway": 0.3 * float(np.sin(5.0 * state.t))}


def controlled(force: Any, **options: Any) -> pinred.Trajectory:
    """Return a motion of the cat between its stops."""
    given: dict[str, Any] = {"duration": 0.8, "stops": STOPS, **COARSE, **options}
    return pinred.simulate(
        pinred.load("falling_cat"), x0=[0.0, 0.1, -0.2], xdot0=[1.0, 0.5, 0.0], forces=[force],
        **given,
    )  # fmt: skip


# `test_stops_of_balls.py` presses a ball against its stop by computed torque.
# A controller calls a function of the same state.
@pytest.mark.by_hand("computed torque", "PD")
@pytest.mark.parametrize(
    "force",
    [
        PD({"bend": BEND, "sway": 0.2}, 2.0, 0.1),
        ComputedTorque({"bend": BEND, "sway": SWAY, "twist": 0.1}, 40.0, 8.0),
        Controller(push, period=0.05, joints=("bend", "sway")),
    ],
    ids=["PD", "computed torque", "controller"],
)
def test_controlled_motions_with_stops_pass_the_comparison(force: Any) -> None:
    """Joints bounce, rest and leave under control."""
    traj = controlled(force)
    assert len(traj.impacts) >= 2
    assert len(traj.motion.modes) >= 2
    report = pinred.compare(traj)
    assert report.verdict is Verdict.PASSED, report


def test_command_that_pulls_releases_a_joint_at_the_time_of_the_call() -> None:
    """The hold changes its sign at 0.65 s, and the joint leaves its stop at this time."""
    traj = controlled(
        Controller(push, period=0.05, joints=("bend", "sway")), stops={"sway": (-0.3, 0.3)}
    )
    times = [t for t, _ in traj.motion.modes]
    assert traj.motion.modes[-1][1] == "no joint at rest"
    assert times[-1] in [0.65, 0.7]
    assert [action.t for action in traj.actions] == pytest.approx(0.05 * np.arange(16), abs=1e-12)
    assert pinred.compare(traj)


def test_torque_that_jumps_releases_a_joint_in_both_routes() -> None:
    """A condition on time that reverses a torque acts like a command."""
    force = Torque(lambda t, *_: [ca.if_else(t < 0.3, 0.5, -0.5), 0.0, 0.0])
    traj = controlled(force, stops={"bend": (-0.5, 0.5)}, duration=0.4)
    assert traj.motion.modes[-1] == (0.3, "no joint at rest")
    assert pinred.compare(traj)


def test_computed_torques_of_a_joint_at_rest_follow_the_law() -> None:
    """The torques are those of the law for all joints, although one of them cannot follow."""
    system = pinred.load("falling_cat")
    goal, kp, kd = np.array([0.9, 0.0, 0.1]), 40.0, 8.0
    reference = dict(zip(system.shape_names, goal.tolist(), strict=True))
    traj = controlled(ComputedTorque(reference, kp, kd))
    (_, _), (rest, label) = traj.motion.modes[:2]
    assert label == "bend at its upper stop"
    model, data = system.model, system.model.createData()
    for k in np.flatnonzero(traj.t > rest)[::20]:
        q, v, x, xdot = traj.q[k], traj.v[k], traj.x[k], traj.xdot[k]
        upper = np.triu(pin.crba(model, data, q))
        H = upper + np.triu(upper, 1).T
        bias = np.array(pin.nonLinearEffects(model, data, q, v))
        a = kp * (goal - x) - kd * xdot
        base = np.linalg.solve(H[:6, :6], -bias[:6] - H[:6, 6:] @ a)
        expected = H[6:, :6] @ base + H[6:, 6:] @ a + bias[6:]
        torques = traj.torques[k] - traj.stop_reactions[k]
        np.testing.assert_allclose(torques, expected, atol=1e-11)
