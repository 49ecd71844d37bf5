"""One joint of a compiled MuJoCo model, and the Pinocchio joint with the same motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ..rebuild import PRISMATIC, REVOLUTE, joint_along
from .world import World


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint of a body, in the frame of the body.

    Attributes:
        name: Name of the joint.
        kind: "free", "ball", "slide" or "hinge".
        point: Point about which the joint rotates, (3,) [m].
        axis: Unit axis, (3,).
        q0: Coordinate in the reference configuration of the file, MuJoCo's qpos0 [rad | m].
        q_at: Index of its first coordinate in qpos.
        v_at: Index of its first velocity in qvel.
        armature: Rotor inertia, (nv,) [kg m² | kg], including actuators with their gears.
    """

    name: str
    kind: str
    point: Array
    axis: Array
    q0: float
    q_at: int
    v_at: int
    armature: Array

    @property
    def nv(self) -> int:
        """Number of degrees of freedom."""
        return len(self.armature)

    @property
    def at_point(self) -> pin.SE3:
        """Frame of the body, translated to the point about which the joint rotates."""
        return translation(self.point)

    def motion(self, value: float) -> pin.SE3:
        """Return the body's displacement, in body axes, for the coordinate of a slide or hinge."""
        return self.at_point * self.displaced(value - self.q0) * self.at_point.inverse()

    def turned(self, attitude: Array) -> pin.SE3:
        """Return the body's displacement, in body axes, for the attitude of a ball.

        Args:
            attitude: Unit quaternion (x, y, z, w), (4,).
        """
        R = pin.Quaternion(np.asarray(attitude, dtype=float)).toRotationMatrix()
        return self.at_point * pin.SE3(R, np.zeros(3)) * self.at_point.inverse()

    def displaced(self, amount: float) -> pin.SE3:
        """Return the displacement by a slide or hinge through `amount` [m | rad]."""
        if amount == 0.0:
            return pin.SE3.Identity()
        if self.kind == "slide":
            return translation(amount * self.axis)
        return pin.SE3(pin.exp3(amount * self.axis), np.zeros(3))

    def twist(self, rate: float) -> pin.Motion:
        """Return the body's twist, in the body's frame, for a rate of a slide or hinge."""
        if self.kind == "slide":
            return pin.Motion(rate * self.axis, np.zeros(3))
        return pin.Motion(rate * np.cross(self.point, self.axis), rate * self.axis)

    def coordinates(self, qpos: Array) -> Array:
        """Return Pinocchio's coordinates of a slide, hinge or ball, (nq,), from qpos."""
        if self.kind == "ball":
            return quaternion(qpos[self.q_at :])
        return qpos[self.q_at : self.q_at + 1].copy()

    def rates(self, qvel: Array) -> Array:
        """Return Pinocchio's rates of a slide, hinge or ball, (nv,), from qvel."""
        return qvel[self.v_at : self.v_at + self.nv].copy()

    def model(self) -> pin.JointModel:
        """Return the Pinocchio joint with the axis of a slide or hinge, or of a ball.

        MuJoCo's angular velocity of a ball is in body axes, too.
        """
        if self.kind == "ball":
            return pin.JointModelSpherical()
        return joint_along(PRISMATIC if self.kind == "slide" else REVOLUTE, self.axis)


def joint_of(world: World, joint: int) -> Joint:
    """Return the joint with an id."""
    model = world.model
    kind = world.kind(joint)
    q_at, v_at = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
    nv = {"free": 6, "ball": 3}.get(kind, 1)
    armature = np.array(model.dof_armature[v_at : v_at + nv])
    return Joint(
        name=world.joint_names[joint],
        kind=kind,
        point=np.array(model.jnt_pos[joint]),
        axis=np.array(model.jnt_axis[joint]),
        q0=float(model.qpos0[q_at]) if nv == 1 else 0.0,
        q_at=q_at,
        v_at=v_at,
        armature=armature + _actuator_armature(world, joint),
    )


def _actuator_armature(world: World, joint: int) -> float:
    """Return the armature that actuators add to a joint: rotor inertia times gear ratio squared."""
    model, armature = world.model, 0.0
    for actuator in np.flatnonzero(model.actuator_armature):
        if acts_on_joint(world, int(actuator)) and model.actuator_trnid[actuator, 0] == joint:
            gear = model.actuator_gear[model.actuator_outadr[actuator], 0]
            armature += float(model.actuator_armature[actuator] * gear**2)
    return armature


def acts_on_joint(world: World, actuator: int) -> bool:
    """Return whether an actuator's transmission is a joint (in the joint or the parent frame)."""
    return int(world.model.actuator_trntype[actuator]) in (0, 1)  # mjTRN_JOINT, mjTRN_JOINTINPARENT


def translation(by: Array) -> pin.SE3:
    """Return a translation by a vector (3,) [m]."""
    return pin.SE3(np.eye(3), np.array(by))


def frame(position: Array, quaternion: Array) -> pin.SE3:
    """Return the frame at a position with orientation (w, x, y, z), a quaternion of any norm."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return pin.SE3(pin.Quaternion(w, x, y, z).toRotationMatrix(), np.array(position))


def wxyz(values: Array) -> Array:
    """Return the leading quaternion (w, x, y, z) of joint coordinates; zero becomes identity."""
    leading = values[:4]
    return leading if leading.any() else np.array([1.0, 0.0, 0.0, 0.0])


def quaternion(values: Array) -> Array:
    """Convert MuJoCo's leading quaternion (w, x, y, z) to a unit quaternion (x, y, z, w)."""
    leading = wxyz(values)
    return np.asarray(np.roll(leading, -1) / np.linalg.norm(leading))
