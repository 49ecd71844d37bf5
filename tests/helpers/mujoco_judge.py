"""Compare a model read from MJCF with MuJoCo: masses, forces and accelerations.

Pose and twist of the root body come from MuJoCo's kinematics and Jacobians, so that they do not
depend on pinred.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco as mj
import numpy as np
import pinocchio as pin

from pinred.common.arrays import Array
from pinred.system.mjcf.compile import compiled
from pinred.system.mjcf.read import gravity_of
from pinred.system.mjcf.tree import Tree, tree_of
from pinred.system.mjcf.world import robot_in

if mj.get_mju_user_warning() is None:
    mj.set_mju_user_warning(lambda _: None)  # do not write a log file about singular shapes
_OFF = ("CONSTRAINT", "CONTACT", "AUTORESET")


@dataclass(frozen=True)
class Errors:
    """Relative differences at one state.

    Attributes:
        mass: Of the mass matrix, relative to its largest entry.
        bias: Of gravity and velocity forces, relative to the terms that they are the sum of.
        residual: Of M a + bias at a random acceleration a, relative to the same terms.
        gravity: Of the forces at rest, relative to the same terms.
    """

    mass: float
    bias: float
    residual: float
    gravity: float

    @property
    def worst(self) -> float:
        """The largest of the four differences."""
        return max(self.mass, self.bias, self.residual, self.gravity)


def read_tree(source: Any, root: str | None = None) -> Tree:
    """Return the robot in a path, an MjSpec or an MjModel, on the given root."""
    world = robot_in(compiled(source), root)
    return tree_of(world, {}, gravity_of(world).effective)


class Judge:
    """A tree and a copy of the MuJoCo model from which it was read."""

    def __init__(self, tree: Tree) -> None:
        """Copy the MuJoCo model of a tree without frozen joints."""
        assert not tree.locked
        self.tree, self.model = tree, tree.model
        self.mujoco: Any = tree.world.model.__copy__()
        for name in _OFF:
            self.mujoco.opt.disableflags |= int(getattr(mj.mjtDisableBit, f"mjDSBL_{name}"))
        self.mujoco.opt.enableflags = 0
        self.data = mj.MjData(self.mujoco)
        self.dofs = self._dofs()
        self.compensated = not gravity_of(tree.world).is_uneven

    def _dofs(self) -> list[int]:
        """Return the indices of the robot's velocities in MuJoCo, root before shape."""
        m, ids = self.mujoco, {n: j for j, n in enumerate(self.tree.world.joint_names)}
        root = [] if self.tree.root is None else [ids[j.name] for j in self.tree.root.joints]
        self.shape_joints = [ids[str(n)] for n in list(self.model.names)[1 + bool(root) :]]
        joints = root + self.shape_joints
        return [
            int(m.jnt_dofadr[j]) + k for j in joints for k in range((6, 3, 1, 1)[m.jnt_type[j]])
        ]

    def _root(self, qvel: Array) -> tuple[Array, Array, Array]:
        """Return q of the root, and the map from MuJoCo's velocities to those of the root.

        The third value is the time derivative of this map times the velocities.
        """
        if self.tree.root is None:
            return np.empty(0), np.empty((0, 0)), np.empty(0)
        m, d, joint = self.mujoco, self.data, self.model.joints[1]
        first = list(self.tree.world.joint_names).index(self.tree.root.joints[0].name)
        body = int(m.jnt_bodyid[first])
        name = self.tree.world.body_names[body]
        frame = self.model.frames[self.model.getFrameId(name, pin.FrameType.BODY)]
        if m.body_jntnum[body] > len(self.tree.root.joints):
            return self._lone_root()
        X = pin.SE3(d.xmat[body].reshape(3, 3), d.xpos[body])
        placement = self.model.jointPlacements[1].inverse() * X * frame.placement.inverse()
        jac, dot = np.zeros((6, m.nv)), np.zeros((6, m.nv))
        mj.mj_jacBody(m, d, jac[:3], jac[3:], body)
        mj.mj_jacDot(m, d, dot[:3], dot[3:], d.xpos[body], body)
        R = np.kron(np.eye(2), X.rotation.T)
        twist = R @ jac @ qvel
        rate = R @ dot @ qvel
        rate[:3] -= np.cross(twist[3:], twist[:3])
        on_joint = (
            frame.placement.action
        )  # maps twists from the frame of the body to that of the joint
        S = _subspace(joint)
        T = S.T @ on_joint @ R @ jac
        return (
            _configuration(joint, placement, S),
            T[:, self.dofs[: joint.nv]],
            S.T @ on_joint @ rate,
        )

    def _lone_root(self) -> tuple[Array, Array, Array]:
        """Return the same if the body has more joints: MuJoCo's coordinates of the root joint."""
        joint, first = self.model.joints[1], self.tree.root.joints[0].q_at  # type: ignore[union-attr]
        assert joint.nv < 6
        q = self.data.qpos[first : first + joint.nq]
        return (np.roll(q, -1) if joint.nq == 4 else q.copy()), np.eye(joint.nv), np.zeros(joint.nv)

    def at(self, qpos: Array, qvel: Array) -> tuple[Array, Array, Array, Array]:
        """Set MuJoCo's state; return q, v, J = ∂v/∂qvel, and v̇ at zero qacc."""
        m, d = self.mujoco, self.data
        d.qpos[:], d.qvel[:] = qpos, qvel
        mj.mj_normalizeQuat(m, d.qpos)
        mj.mj_forward(m, d)
        q_root, T, rate = self._root(d.qvel)
        r, n = len(T), self.model.nv
        J = np.eye(n)
        J[:r, :r] = T
        shape = [_coordinates(m, d.qpos, j) for j in self.shape_joints]
        drift = np.concatenate([rate, np.zeros(n - r)])
        return np.concatenate([q_root, *shape]), J @ d.qvel[self.dofs], J, drift

    def errors(self, rng: np.random.Generator, spread: float = 1.0) -> Errors:
        """Compare the models at a random state."""
        m, d, n = self.mujoco, self.data, self.model.nv
        qpos = m.qpos0 + spread * rng.uniform(-1.0, 1.0, m.nq)
        q, v, J, drift = self.at(qpos, rng.normal(size=m.nv))
        M = np.zeros((m.nv, m.nv))
        mj.mj_fullM(m, d, M)
        M = M[np.ix_(self.dofs, self.dofs)]
        bias = self._bias()
        data = self.model.createData()
        H = np.triu(pin.crba(self.model, data, q))
        H = H + np.triu(H, 1).T
        acceleration = rng.normal(size=n)
        a = J @ acceleration + drift

        def forces(v: Array, a: Array) -> Array:
            return np.asarray(J.T @ pin.rnea(self.model, data, q, v, a))

        zero = np.zeros(n)
        rest_forces = forces(zero, zero)
        d.qvel[:] = 0.0
        mj.mj_forward(m, d)
        rest_bias = self._bias()
        scale = self._terms(J, q, v, a)
        return Errors(
            mass=_ratio(J.T @ H @ J - M, np.abs(M).max()),
            bias=_ratio(forces(v, drift) - bias, scale),
            residual=_ratio(forces(v, a) - M @ acceleration - bias, scale),
            gravity=_ratio(rest_forces - rest_bias, scale),
        )

    def _bias(self) -> Array:
        """Return MuJoCo's bias force; pinred ignores gravity compensation of single bodies."""
        compensation = self.data.qfrc_gravcomp if self.compensated else 0.0
        return np.asarray((self.data.qfrc_bias - compensation)[self.dofs])

    def _terms(self, J: Array, q: Array, v: Array, a: Array) -> Array:
        """Return the largest contribution of a body to the force of each coordinate, (n,)."""
        model, data = self.model, self.model.createData()
        pin.rnea(model, data, q, v, a)
        pin.computeJointJacobians(model, data, q)
        largest = np.zeros(model.nv)
        g = np.linalg.norm(model.gravity.linear)
        for i in range(1, model.njoints):
            inertia, v_i, a_i = model.inertias[i], data.v[i], data.a_gf[i]
            reach = np.linalg.norm(inertia.lever) + 1e-3
            w = np.linalg.norm(v_i.angular)
            force = inertia.mass * (
                np.linalg.norm(a_i.linear) + g + w * np.linalg.norm(v_i.linear) + w * w * reach
            )
            moment = np.linalg.norm(inertia.inertia) * (np.linalg.norm(a_i.angular) + w * w)
            S = np.abs(pin.getJointJacobian(model, data, i, pin.ReferenceFrame.LOCAL))
            largest = np.maximum(
                largest, S[:3].sum(axis=0) * force + S[3:].sum(axis=0) * (moment + reach * force)
            )
        return np.asarray(np.abs(J).T @ largest + largest.max() * 1e-3 + 1e-300)


def _coordinates(mujoco: Any, qpos: Array, joint: int) -> Array:
    """Return Pinocchio's coordinates of a slide, a hinge or a ball."""
    first = int(mujoco.jnt_qposadr[joint])
    if mujoco.jnt_type[joint] == int(mj.mjtJoint.mjJNT_BALL):
        return np.roll(qpos[first : first + 4], -1)
    return qpos[first : first + 1].copy()


def _ratio(error: Array, scale: Array | float) -> float:
    return float((np.abs(error) / scale).max(initial=0.0))


def _subspace(joint: pin.JointModel) -> Array:
    """Return the motion subspace of a root joint, (6, nv)."""
    joint_type = joint.shortname()
    if "Free" in joint_type:
        return np.eye(6)
    if "Spherical" in joint_type:
        return np.eye(6)[:, 3:]
    if "Planar" in joint_type:
        return np.eye(6)[:, [0, 1, 5]]
    if "Composite" in joint_type:  # a prismatic joint followed by a planar joint
        return np.eye(6)[:, [2, 0, 1, 5]]
    data = joint.createData()
    joint.calc(data, np.zeros(joint.nq), np.ones(joint.nv))
    return np.array(data.S).reshape(6, 1)


def _configuration(joint: pin.JointModel, placement: pin.SE3, S: Array) -> Array:
    """Return the coordinates of a root joint for a placement of its body."""
    joint_type, R, p = joint.shortname(), placement.rotation, placement.translation
    if "Free" in joint_type:
        return np.asarray(pin.SE3ToXYZQUAT(placement))
    if "Spherical" in joint_type:
        return np.asarray(pin.Quaternion(R).coeffs())
    if "Planar" in joint_type:
        return np.array([p[0], p[1], R[0, 0], R[1, 0]])
    if "Composite" in joint_type:
        return np.array([p[2], p[0], p[1], R[0, 0], R[1, 0]])
    axis = S[:3, 0] if S[:3].any() else S[3:, 0]
    if S[:3].any():
        return np.array([axis @ p])
    sine = 0.5 * axis @ [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]
    return np.array([np.arctan2(sine, 0.5 * (np.trace(R) - 1.0))])
