"""Prescribed joints of robots with closed loops, against a KKT system of Pinocchio's matrices."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from loop_robots import five_bar, four_bar
from scipy.integrate import solve_ivp

import pinred
from pinred.common.arrays import Array
from pinred.common.errors import InputError
from pinred.system.loops.looped_system import loop_values

FREQUENCY, HEIGHT = 2.0, 0.4


@pytest.fixture(scope="module")
def linkage() -> pinred.System:
    """Return the five-bar linkage, which has two degrees of freedom."""
    model, loops = five_bar()
    return pinred.load(model, loops=loops)


@pytest.fixture(scope="module")
def driven(linkage: pinred.System) -> pinred.Trajectory:
    """Return a motion of the linkage with one prescribed crank and a spring at the other."""
    return pinred.simulate(scene_of(linkage))


def scene_of(system: pinred.System) -> pinred.Scene:
    """Return the scene of `driven`."""
    assert system.closure is not None
    plan = f"{float(system.closure.x[0])!r} + {HEIGHT}*sin({FREQUENCY}*t)"
    return pinred.Scene(
        system=system, x0=system.closure.x, xi0=[0.1, 0.0, 0.3], prescribed={"left_crank": plan},
        springs={"right_crank": (3.0, 0.2)}, duration=0.5,
    )  # fmt: skip


def kkt(model: pin.Model, t: float, q: Array, v: Array) -> tuple[Array, float, Array]:
    """Return acceleration, torque of the drive, and force on the right tip in the world's axes."""
    data, n = model.createData(), model.nv
    names = ("left_tip", "right_tip")
    pin.computeAllTerms(model, data, q, v)
    pin.forwardKinematics(model, data, q, v, np.zeros(n))
    axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    ids = [model.getFrameId(name) for name in names]
    J = [pin.computeFrameJacobian(model, data, q, k, axes)[:2] for k in ids]
    pin.forwardKinematics(model, data, q, v, np.zeros(n))
    bias = [pin.getFrameClassicalAcceleration(model, data, k, axes).linear[:2] for k in ids]
    drive = np.eye(n)[[3]]
    C = np.vstack([J[1] - J[0], drive])
    wanted = -HEIGHT * FREQUENCY**2 * np.sin(FREQUENCY * t)
    tau = np.zeros(n)
    tau[5] = -3.0 * (q[6] - 0.2)
    H = np.triu(data.M) + np.triu(data.M, 1).T
    K = np.block([[H, -C.T], [C, np.zeros((3, 3))]])
    right = np.concatenate([tau - data.nle, bias[0] - bias[1], [wanted]])
    solved = np.linalg.solve(K, right)
    return solved[:n], float(solved[-1]), solved[n : n + 2]


def test_motion_torque_and_loop_force_equal_a_kkt_system(
    linkage: pinred.System, driven: pinred.Trajectory
) -> None:
    """The multipliers of the KKT system are the loop force and the torque of the drive."""
    model, nq = linkage.model, linkage.model.nq
    assert list(model.names)[2:] == ["left_crank", "left_coupler", "right_crank", "right_coupler"]

    def rate(t: float, y: Array) -> Array:
        a, _, _ = kkt(model, t, y[:nq], y[nq:])
        turn, v = y[2:4], y[nq:]
        speed = np.array([[turn[0], -turn[1]], [turn[1], turn[0]]]) @ v[:2]
        return np.concatenate([speed, v[2] * np.array([-turn[1], turn[0]]), v[3:], a])

    start = np.concatenate([driven.q[0], driven.v[0]])
    end = solve_ivp(rate, (0.0, 0.5), start, "DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(driven.q[-1], end[:nq], atol=1e-10)
    np.testing.assert_allclose(driven.v[-1], end[nq:], atol=1e-9)
    for k in (0, len(driven) // 2, -1):
        q, v = driven.q[k], driven.v[k]
        _, torque, force = kkt(model, float(driven.t[k]), q, v)
        np.testing.assert_allclose(driven.driving_torques[k], torque, rtol=1e-9)
        angle = np.arctan2(q[3], q[2]) + driven.x[k, 0] + driven.x[k, 1]  # of the left coupler
        axes = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        found = driven.loop_forces["tips"][k, :2]
        np.testing.assert_allclose(found, axes @ force, rtol=1e-9, atol=1e-12)


def test_loops_stay_closed_and_compare_passes(
    linkage: pinred.System, driven: pinred.Trajectory
) -> None:
    """The work of the drive balances the energy."""
    plan = linkage.closure.x[0] + HEIGHT * np.sin(FREQUENCY * driven.t)  # type: ignore[union-attr]
    np.testing.assert_allclose(driven.x[:, 0], plan, rtol=1e-14)
    assert max(np.abs(loop_values(linkage, x)).max() for x in driven.x) < 1e-10
    assert np.abs(driven.energy_balance.residual).max() < 1e-9
    report = pinred.compare(pinred.simulate(scene_of(linkage), duration=0.03))
    assert report.passed, str(report)


def test_both_engines_agree_with_prescribed_joints(driven: pinred.Trajectory) -> None:
    """A driven crank leaves the linkage one degree of freedom."""
    readable = pinred.simulate(driven.scene, engine="pinocchio")
    np.testing.assert_allclose(readable.x, driven.x, atol=1e-10)
    np.testing.assert_allclose(readable.pose, driven.pose, atol=1e-10)


def test_members_with_prescribed_joints_equal_single_simulations() -> None:
    """A driven crank determines the four-bar; the members differ in the parameter of the plan."""
    model, loops = four_bar()
    system = pinred.load(model, loops=loops)
    scenes = [
        pinred.Scene(system=system, momentum=0, prescribed={"crank": f"1 + {w}*t"}, duration=0.5)
        for w in (1.0, 2.0)
    ]
    many = pinred.simulate_many(scenes)
    for member, scene in enumerate(scenes):
        alone = pinred.simulate(scene)
        np.testing.assert_allclose(many[member].x, alone.x, atol=1e-12)
        np.testing.assert_allclose(many[member].pose, alone.pose, atol=1e-12)


def test_errors_of_computed_torque_decay_as_stated(linkage: pinred.System) -> None:
    """Both cranks are driven against a spring at a coupler: ë = −kd ė − kp e in closed form."""
    assert linkage.closure is not None
    x0, kp, kd = linkage.closure.x, 9.0, 4.0
    goals = {"left_crank": float(x0[0]) - 0.1, "right_crank": float(x0[2])}
    force = pinred.forces.ComputedTorque(goals, kp, kd)
    scene = pinred.Scene(
        system=linkage, x0=x0, xi0=[0.1, 0.0, 0.3], forces=[force],
        springs={"right_coupler": (3.0, 0.2)}, duration=1.0,
    )  # fmt: skip
    traj = pinred.simulate(scene)
    a, w, t = 0.5 * kd, np.sqrt(kp - 0.25 * kd**2), traj.t
    error = 0.1 * np.exp(-a * t) * (np.cos(w * t) + a / w * np.sin(w * t))
    np.testing.assert_allclose(traj.x[:, 0] - goals["left_crank"], error, atol=1e-10)
    np.testing.assert_allclose(traj.x[:, 2], x0[2], atol=1e-10)
    assert pinred.compare(pinred.simulate(scene, duration=0.03)).passed
    one = pinred.forces.ComputedTorque({"left_crank": 0.0}, kp, kd)
    with pytest.raises(InputError, match=r"references and plans for 2 joints, .* got 1"):
        pinred.Scene(system=linkage, x0=x0, forces=[one], duration=1.0)


def test_plans_that_contradict_loops_are_refused(linkage: pinred.System) -> None:
    """Loops that do not close at time 0, and more plans than degrees of freedom."""
    model, loops = four_bar()
    system = pinred.load(model, loops=loops)
    with pytest.raises(InputError, match=r"prescribed: the loops of 'four_bar' do not close with"):
        pinred.Scene(system=system, momentum=0, prescribed={"rocker": 0.0}, duration=1.0)
    assert system.closure is not None
    plans = {name: float(x) for name, x in zip(system.shape_names, system.closure.x, strict=True)}
    with pytest.raises(InputError, match=r"prescribed: the motions of crank, .* at most 1 joints"):
        pinred.Scene(system=system, momentum=0, prescribed=plans, duration=1.0)
    with pytest.raises(NotImplementedError, match="flow with prescribed joints"):
        pinred.flow(scene_of(linkage), wrt=["xi0"])
