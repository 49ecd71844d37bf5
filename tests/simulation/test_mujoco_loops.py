"""Motions of robots with loops against MuJoCo's mass matrix with its constraints as exact ones."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import mujoco
import numpy as np
import pytest
from constraint_dynamics import constraint_dynamics
from loop_robots import cassie_like, delta, gripper
from scipy.integrate import solve_ivp

import pinred
from pinred.common.arrays import Array
from pinred.judge.full_system import CouplingConstraints

_RANK = 1e-8  # smallest singular value of independent constraints, relative to the largest


class HardConstraints:
    """Accelerations of a MuJoCo model with its equality constraints as exact ones.

    H a + b = f + Jᵀλ, J a + J̇ v = 0, with MuJoCo's mass matrix H, bias b, passive forces f and
    constraint Jacobian J, and differences of fourth order for J̇ v.
    """

    def __init__(self, text: str) -> None:
        """Compile a model."""
        self.model = mujoco.MjModel.from_xml_string(text)
        self._data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self._data)
        self._rows = self._data.efc_type == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)

    def acceleration(self, qpos: Array, qvel: Array) -> Array:
        """Return the acceleration, (nv,)."""
        model, data, h = self.model, self._data, 1e-3
        J = {k: self._jacobian(qpos, qvel, k * h) for k in (-2, -1, 1, 2)}
        drift = (J[-2] - 8.0 * J[-1] + 8.0 * J[1] - J[2]) @ qvel / (12.0 * h)
        at = self._jacobian(qpos, qvel, 0.0)
        H = np.empty((model.nv, model.nv))
        mujoco.mj_fullM(model, data, H)
        force = data.qfrc_passive - data.qfrc_bias
        response = np.linalg.solve(H, np.column_stack([force, at.T]))
        right = -drift - at @ response[:, 0]
        multipliers = np.linalg.lstsq(at @ response[:, 1:], right, rcond=_RANK)[0]
        return np.asarray(response @ np.append(1.0, multipliers))

    def end(self, qpos: Array, qvel: Array, duration: float) -> tuple[Array, Array]:
        """Return the final qpos and qvel of a motion, integrated in the tangent space."""
        model, nv = self.model, self.model.nv
        middle = qpos
        for start, stop in pairwise(np.linspace(0.0, duration, 4)):

            def rate(_: float, y: Array, middle: Array = middle) -> Array:
                at = middle.copy()
                mujoco.mj_integratePos(model, at, y[:nv], 1.0)
                a = self.acceleration(at, y[nv:])
                return np.concatenate([self._chart_rate(y[:nv], y[nv:]), a])

            y0 = np.concatenate([np.zeros(nv), qvel])
            y = solve_ivp(rate, (start, stop), y0, "DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
            mujoco.mj_integratePos(model, middle := middle.copy(), y[:nv], 1.0)
            qvel = y[nv:]
        return middle, qvel

    def _jacobian(self, qpos: Array, qvel: Array, time: float) -> Array:
        data = self._data
        data.qpos[:], data.qvel[:] = qpos, qvel
        mujoco.mj_integratePos(self.model, data.qpos, qvel, time)
        mujoco.mj_forward(self.model, data)
        return np.array(data.efc_J.reshape(-1, self.model.nv)[self._rows])

    def _chart_rate(self, y: Array, v: Array) -> Array:
        """Return dy/dt with qpos = middle ∘ exp(y): for rotations, the inverse of dexp."""
        rate = v.copy()
        for joint in range(self.model.njnt):
            at, kind = int(self.model.jnt_dofadr[joint]), int(self.model.jnt_type[joint])
            if kind > 1:
                continue
            part = slice(at + 3, at + 6) if kind == 0 else slice(at, at + 3)
            w, angle = y[part], float(np.linalg.norm(y[part]))
            hat = np.cross(np.eye(3), w)
            c = 1.0 / 12.0 if angle < 1e-4 else (1.0 - 0.5 * angle / np.tan(0.5 * angle)) / angle**2
            rate[part] = v[part] + 0.5 * hat @ v[part] + c * hat @ hat @ v[part]
        return rate


def states(model: mujoco.MjModel, traj: pinred.Trajectory, k: int) -> tuple[Array, Array]:
    """Return MuJoCo's qpos and qvel of a robot on a free joint at time k."""
    q, v, system = traj.q[k], traj.v[k], traj.system
    qpos, qvel = np.zeros(model.nq), np.zeros(model.nv)
    w = np.concatenate([q[:3], q[6:7], q[3:6]])
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, w[3:])
    qpos[:7], qvel[:6] = w, np.concatenate([R.reshape(3, 3) @ v[:3], v[3:6]])
    for i in range(2, system.model.njoints):
        joint, own = system.model.joints[i], model.joint(str(system.model.names[i]))
        values = q[joint.idx_q : joint.idx_q + joint.nq]
        at, at_v = int(own.qposadr[0]), int(own.dofadr[0])
        qpos[at : at + joint.nq] = np.roll(values, 1) if joint.nq == 4 else values
        qvel[at_v : at_v + joint.nv] = v[joint.idx_v : joint.idx_v + joint.nv]
    return qpos, qvel


ROBOTS: dict[str, tuple[Callable[[], str], tuple[int, ...], dict[str, float], float]] = {
    # text, (joint rates, equations, rank), initial rates, duration
    "Cassie-like": (cassie_like, (26, 12, 10), {"left_knee": 1.0, "right_roll": -0.5}, 0.1),
    "gripper": (gripper, (5, 6, 4), {"right_driver": 2.0}, 0.3),
}


@pytest.mark.parametrize(
    "name", ["gripper", pytest.param("Cassie-like", marks=pytest.mark.by_hand)]
)
def test_motion_equals_hard_constraints_of_mujoco(name: str) -> None:
    """Positions and velocities agree to 1e-9, at 3,000 rad/s of stiff springs.

    AdaptiveGauss follows the springs; DOP853 at its stability limit damps them.
    """
    text, sizes, rates, duration = ROBOTS[name]
    judge = HardConstraints(text())
    system = pinred.load(mujoco.MjModel.from_xml_string(text()))
    assert system.closure is not None
    assert (system.m, system.closure.equations, system.closure.rank) == sizes
    traj = pinred.simulate(
        system, xdot0=rates, xi0=[0.1, 0.0, 0.0, 0.3, 0.2, 0.5], duration=duration,
        method=pinred.AdaptiveGauss(1e-13, 1e-15), passive=True,
    )  # fmt: skip
    assert np.abs(traj.x[-1] - traj.x[0]).max() > 0.05
    qpos, qvel = judge.end(*states(judge.model, traj, 0), duration)
    expected, expected_rates = states(judge.model, traj, -1)
    np.testing.assert_allclose(qpos, expected, rtol=0.0, atol=1e-10)
    bar = 1e-9 * max(1.0, np.abs(qvel).max())
    np.testing.assert_allclose(qvel, expected_rates, rtol=0.0, atol=bar)


def test_delta_of_rank_nine_needs_few_evaluations_and_equals_constraint_dynamics() -> None:
    """Nine of 18 equations are redundant: 47 evaluations, where 200 are allowed."""
    model, loops = delta()
    system = pinred.load(model, loops=loops)
    assert system.closure is not None
    sizes = (system.m, system.closure.equations, system.closure.rank, system.shape_dim)
    assert sizes == (14, 18, 9, 5)
    traj = pinred.simulate(system, seed=0, duration=0.3, rtol=1e-10)
    assert traj.motion.evaluations <= 200
    solve = constraint_dynamics(system.sorted_model, *loops)
    forces = np.zeros(system.model.nv)
    error = error_of(traj, lambda q, v: solve(q, v, forces)[0])
    assert error < 1e-8


def test_gripper_with_a_coupling_equals_multipliers_to_eleven_digits() -> None:
    """In the manner of the Robotiq 2F-85: two loops and a follower, by ABA and multipliers."""
    system = pinred.load(mujoco.MjModel.from_xml_string(gripper()))
    traj = pinred.simulate(
        system, xdot0={"right_driver": 2.0}, xi0=[0.1, 0.0, 0.0, 0.3, 0.2, 0.5], duration=0.3,
        rtol=1e-11,
    )  # fmt: skip
    assert np.abs(traj.x[-1] - traj.x[0]).max() > 0.5
    judge, forces = CouplingConstraints(system), np.zeros(system.model.nv)
    assert error_of(traj, lambda q, v: judge.acceleration(q, v, forces)) < 1e-11


def error_of(traj: pinred.Trajectory, acceleration: Callable[[Array, Array], Array]) -> float:
    """Return the largest error of the final q and v, relative to the largest number in it."""
    system, tree = traj.system, traj.system.sorted_model

    def rate(_: float, y: Array) -> Array:
        q = np.concatenate([y[:3], y[3:7] / np.linalg.norm(y[3:7]), y[7 : tree.nq]])
        v = y[tree.nq :]
        return np.concatenate([_coordinate_rate(q, v), acceleration(q, v)])

    y0, expected = (
        np.concatenate([system.sort_q(traj.q[k]), system.sort_v(traj.v[k])]) for k in (0, -1)
    )
    span = (float(traj.t[0]), float(traj.t[-1]))
    y = solve_ivp(rate, span, y0, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    return float(np.abs(y - expected).max() / np.abs(y).max())


def _coordinate_rate(q: Array, v: Array) -> Array:
    """Return q̇ of a free flyer with hinges."""
    x, y, z, w = q[3:7]
    E = 0.5 * np.array([[w, -z, y], [z, w, -x], [-y, x, w], [-x, -y, -z]])
    a, b = q[3:6], v[:3]
    turned = b + 2.0 * np.cross(a, np.cross(a, b) + w * b)
    return np.concatenate([turned, E @ v[3:6], v[6:]])
