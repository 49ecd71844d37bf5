"""One joint of a compiled MuJoCo model, as MuJoCo moves it, and the Pinocchio joint that it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from .world import World

# Pinocchio's joints along and about the axes of the frame; faster than those about any axis.
_ALIGNED = {
    "slide": (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ),
    "hinge": (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ),
}
_UNALIGNED = {
    "slide": pin.JointModelPrismaticUnaligned,
    "hinge": pin.JointModelRevoluteUnaligned,
}


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint of a body, in the body's frame.

    kind: free, ball, slide or hinge.  point: (3,), where it turns.  axis: (3,) of unit
    length.  q0: its coordinate where the file has it drawn (MuJoCo's qpos0).
    q_at, v_at: where its coordinates begin in qpos and qvel.
    armature: (nv,) what rotors add, those of actuators with their gears included.
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

    def motion(self, value: float) -> pin.SE3:
        """Return how a slide or hinge at a coordinate moves its body, in the body's frame."""
        return self.at_point * self.turned(value - self.q0) * self.at_point.inverse()

    @property
    def at_point(self) -> pin.SE3:
        """The frame of the body, moved to where the joint turns."""
        return shifted(self.point)

    def turned(self, by: float) -> pin.SE3:
        """Return the motion of a slide or hinge by an amount, about its own point."""
        if by == 0.0:
            return pin.SE3.Identity()
        if self.kind == "slide":
            return shifted(by * self.axis)
        return pin.SE3(pin.exp3(by * self.axis), np.zeros(3))

    def twist(self, rate: float) -> pin.Motion:
        """Return the twist that a slide or hinge gives its body, in the body's frame."""
        zero = np.zeros(3)
        if self.kind == "slide":
            return pin.Motion(rate * self.axis, zero)
        return pin.Motion(rate * np.cross(self.point, self.axis), rate * self.axis)

    def model(self) -> pin.JointModel:
        """Return Pinocchio's joint along or about the axis of a slide or hinge."""
        for k, made in enumerate(_ALIGNED[self.kind]):
            if np.array_equal(self.axis, np.eye(3)[k]):
                return made()
        return _UNALIGNED[self.kind](self.axis)


def joint_of(world: World, joint: int) -> Joint:
    """Return the joint of a number."""
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
        armature=armature + _of_actuators(world, joint),
    )


def _of_actuators(world: World, joint: int) -> float:
    """Return the armature that actuators add to a joint: that of each, times its gear squared."""
    model, added = world.model, 0.0
    for actuator in np.flatnonzero(model.actuator_armature):
        if acts_on_joint(world, int(actuator)) and model.actuator_trnid[actuator, 0] == joint:
            gear = model.actuator_gear[model.actuator_outadr[actuator], 0]
            added += float(model.actuator_armature[actuator] * gear**2)
    return added


def acts_on_joint(world: World, actuator: int) -> bool:
    """Return whether an actuator acts on a joint (in its own or in its parent's frame)."""
    return int(world.model.actuator_trntype[actuator]) in (0, 1)  # mjTRN_JOINT, JOINTINPARENT


def shifted(by: Array) -> pin.SE3:
    """Return a translation."""
    return pin.SE3(np.eye(3), np.array(by))


def frame(position: Array, quaternion: Array) -> pin.SE3:
    """Return the frame of a position and of MuJoCo's quaternion (w, x, y, z), of any length."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return pin.SE3(pin.Quaternion(w, x, y, z).toRotationMatrix(), np.array(position))
