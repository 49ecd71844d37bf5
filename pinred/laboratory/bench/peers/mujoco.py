"""MuJoCo on the same model: its integrators, mj_forward under SciPy, and its rollout."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np
import pinocchio as pin

from ....common.arrays import Array
from ....common.errors import UnsupportedOperationError
from ....lie.group import Group
from ....system.system import System
from ..problems import End, PreparedRun, Problem, Solver, halvings, steps_of
from .aba import Field, PeerModel, missing_unless_equal, scipy_methods


class MujocoModel(PeerModel):
    """A MuJoCo model of a system, built body by body, and the conversion of coordinates.

    Raises UnsupportedOperationError for a free base with a placement other than the identity.
    """

    def __init__(self, system: System) -> None:
        """Build the model."""
        mj = import_module("mujoco")
        if mj.get_mju_user_warning() is None:
            # Suppress the log file of diverging motions; divergence is detected in the final state.
            mj.set_mju_user_warning(lambda _: None)
        self.mj, self.system = mj, system
        self._m, self._has_quaternion = system.m, system.group.turns == 3
        if (
            self._has_quaternion
            and system.group.linear
            and not np.array_equal(system.model.jointPlacements[1].homogeneous, np.eye(4))
        ):
            raise UnsupportedOperationError("its free joint must be at the world's origin")
        self.model = self._build().compile()
        self.data = mj.MjData(self.model)

    def _build(self) -> Any:
        mj, model, system = self.mj, self.system.model, self.system
        spec = mj.MjSpec()
        spec.compiler.degree = False
        spec.compiler.balanceinertia = False
        spec.option.gravity = system.gravity
        bits = mj.mjtDisableBit
        spec.option.disableflags = int(
            bits.mjDSBL_CONSTRAINT | bits.mjDSBL_CONTACT | bits.mjDSBL_AUTORESET
        )
        axes = model.createData()
        pin.computeJointJacobians(model, axes, pin.neutral(model))
        bodies = [spec.worldbody]
        for i in range(1, model.njoints):
            place = model.jointPlacements[i]
            body = bodies[model.parents[i]].add_body(name=f"body{i}")
            body.pos, body.quat = place.translation, _wxyz(place.rotation)
            self._add_inertia(body, model.inertias[i])
            if i == 1:
                self._add_root(body, np.array(axes.joints[1].S).reshape(6, -1))
            else:
                S = np.array(axes.joints[i].S).reshape(6)
                self._add_joint(body, S, model.armature[model.joints[i].idx_v], f"joint{i}")
            bodies.append(body)
        return spec

    def _add_inertia(self, body: Any, inertia: pin.Inertia) -> None:
        moments, axes = np.linalg.eigh(inertia.inertia)
        axes[:, 0] *= np.sign(np.linalg.det(axes))
        body.explicitinertial = True
        body.mass, body.ipos = inertia.mass, inertia.lever
        body.iquat, body.inertia = _wxyz(axes), moments

    def _add_joint(self, body: Any, S: Array, armature: float, name: str) -> None:
        kinds = self.mj.mjtJoint
        slides = bool(S[:3].any())
        body.add_joint(
            name=name,
            type=kinds.mjJNT_SLIDE if slides else kinds.mjJNT_HINGE,
            axis=S[:3] if slides else S[3:],
            armature=armature,
        )

    def _add_root(self, body: Any, S: Array) -> None:
        kinds = self.mj.mjtJoint
        if self._has_quaternion:
            free = bool(self.system.group.linear)
            body.add_joint(name="root", type=kinds.mjJNT_FREE if free else kinds.mjJNT_BALL)
        else:
            for k in range(self.system.r):
                self._add_joint(body, S[:, k], self.system.model.armature[k], f"root{k}")

    def qpos(self, q: Array, x: Array) -> Array:
        """Convert Pinocchio's q and the unwrapped shape to MuJoCo's coordinates."""
        pose = self.system.configuration(q).pose
        if self._has_quaternion:
            pose = np.concatenate([pose[:-4], pose[-1:], pose[-4:-1]])
        return np.concatenate([pose, x])

    def qvel(self, q: Array, v: Array) -> Array:
        """Convert Pinocchio's v to MuJoCo's velocities."""
        return np.asarray(self.turn(q) @ v)

    def end(self, qpos: Array, qvel: Array, evaluations: float) -> End:
        """Convert a final state to Pinocchio's coordinates."""
        pose, x = qpos[: -self._m or None].copy(), qpos[len(qpos) - self._m :].copy()
        if self._has_quaternion:
            pose[-4:] = np.append(pose[-3:], pose[-4]) / np.linalg.norm(pose[-4:])
        q = self.system.q(pose, x)
        return End(x, q, self.turn(q).T @ qvel, evaluations)

    def equations(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return MuJoCo's mass matrix and accelerations without torques."""
        self.data.qpos[:] = self.qpos(q, self.system.configuration(q).x)
        self.data.qvel[:] = self.qvel(q, v)
        self.mj.mj_forward(self.model, self.data)
        H = np.empty((self.system.n, self.system.n))
        self.mj.mj_fullM(self.model, self.data, H)
        return H, self.data.qacc


def _wxyz(rotation: Array) -> Array:
    x, y, z, w = pin.Quaternion(rotation).normalized().coeffs()
    return np.array([w, x, y, z])


def _stepping(problem: Problem, fraction: float, integrator: str, stages: int) -> PreparedRun:
    bridge = MujocoModel.of(problem.system)
    mj, model, data = bridge.mj, bridge.model, bridge.data
    count, duration = steps_of(fraction), problem.start.duration
    qpos, qvel = bridge.qpos(problem.q0, problem.start.x), bridge.qvel(problem.q0, problem.v0)
    integrator_type = getattr(mj.mjtIntegrator, f"mjINT_{integrator}")

    def run() -> tuple[Array, Array]:
        model.opt.timestep, model.opt.integrator = duration / count, integrator_type
        mj.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = qpos, qvel
        mj.mj_step(model, data, count)
        return data.qpos.copy(), data.qvel.copy()

    return PreparedRun(run, lambda state: bridge.end(state[0], state[1], stages * count))


def _field(problem: Problem) -> Field:
    """Return the vector field on (qpos, qvel), evaluated by mj_forward."""
    bridge = MujocoModel.of(problem.system)
    model, data, forward = bridge.model, bridge.data, bridge.mj.mj_forward
    nq, rate_of = model.nq, _rates(problem.system.group)
    qpos, qvel, qacc = data.qpos, data.qvel, data.qacc

    def rate(t: float, y: Array) -> Array:  # noqa: ARG001
        qpos[:], qvel[:] = y[:nq], y[nq:]
        forward(model, data)
        ydot = np.empty(len(y))
        rate_of(ydot[:nq], y, y[nq:])
        ydot[nq:] = qacc
        return ydot

    def end(y: Array, evaluations: float) -> End:
        return bridge.end(y[:nq], y[nq:], evaluations)

    y0 = np.concatenate(
        [bridge.qpos(problem.q0, problem.start.x), bridge.qvel(problem.q0, problem.v0)]
    )
    return Field(rate, y0, end)


def _rates(group: Group) -> Callable[[Array, Array, Array], None]:
    """Return a function that writes d(qpos)/dt to its first argument."""
    if group.turns < 3:

        def translating(target: Array, _: Array, v: Array) -> None:
            target[:] = v

        return translating
    k = group.linear

    def rotating(target: Array, y: Array, v: Array) -> None:
        target[:k] = v[:k]
        w, x, y_, z = y[k : k + 4].tolist()
        a, b, c = v[k : k + 3].tolist()
        target[k : k + 4] = (
            -0.5 * (x * a + y_ * b + z * c),
            0.5 * (w * a + y_ * c - z * b),
            0.5 * (w * b + z * a - x * c),
            0.5 * (w * c + x * b - y_ * a),
        )
        target[k + 4 :] = v[k + 3 :]

    return rotating


_missing = missing_unless_equal("mujoco", "MuJoCo", MujocoModel.of)
_STEPS = halvings(50, 14)

MUJOCO = (
    *(
        Solver(
            f"mujoco-{name}",
            f"MuJoCo's mj_step with {text}, equal steps in C",
            _STEPS,
            partial(_stepping, integrator=name.upper(), stages=stages),
            _missing,
            fixed=True,
        )
        for name, text, stages in (
            ("euler", "semi-implicit Euler", 1),
            ("implicitfast", "implicitfast", 1),
            ("rk4", "RK4", 4),
        )
    ),
    *scipy_methods("mujoco", "MuJoCo's mj_forward", _field, _missing),
)


_CHUNK = 1000  # number of steps in one call; rollout stores the states of all steps
_MEMBERS = 2


def _prepare_rollout(members: Sequence[Problem], fraction: float) -> PreparedRun:
    bridge = MujocoModel.of(members[0].system)
    rollout = import_module("mujoco.rollout")
    mj, model = bridge.mj, bridge.model
    count, duration = steps_of(fraction), members[0].start.duration
    initial = [
        np.concatenate([[0.0], bridge.qpos(p.q0, p.start.x), bridge.qvel(p.q0, p.v0)])
        for p in members
    ]
    data, start = mj.MjData(model), np.array(initial)

    def run() -> Array:
        model.opt.timestep, model.opt.integrator = duration / count, mj.mjtIntegrator.mjINT_RK4
        states, done = start, 0
        while done < count:
            steps = min(_CHUNK, count - done)
            history, _ = rollout.rollout(model, data, states, nstep=steps)
            states, done = np.ascontiguousarray(history[:, -1]), done + steps
        return states

    def end(states: Array, member: int) -> End:
        qpos, qvel = np.split(states[member, 1 : 1 + model.nq + model.nv], [model.nq])
        return bridge.end(qpos, qvel, 4 * count)

    return PreparedRun(run, end)


ROLLOUT = (
    Solver(
        "mujoco-rollout",
        "MuJoCo's rollout with RK4, equal steps",
        halvings(400, 10),
        _prepare_rollout,
        missing_unless_equal("mujoco", "MuJoCo", MujocoModel.of),
        most=_MEMBERS,
    ),
)
