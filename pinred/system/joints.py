"""Pinocchio's joints as root joints of a group, or as joints of the shape."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..lie.group import Group
from ..lie.groups import GROUPS


def joint_kind(joint: pin.JointModel) -> str:
    """Return Pinocchio's name of a joint; for a composite joint, its components joined by "+"."""
    kind = str(joint.shortname()).removeprefix("JointModel")
    if kind != "Composite":
        return kind
    composite = joint.extract()
    shifted = any(not place.isIdentity() for place in composite.jointPlacements)
    return kind if shifted else "+".join(map(joint_kind, composite.joints))


def motion_group(joint: pin.JointModel) -> Group | None:
    """Return the group in which a joint moves its body, or None if it is no known group."""
    kind = joint_kind(joint)
    return next((group for group in GROUPS.values() if kind in group.joints), None)


def is_shape_joint(joint: pin.JointModel) -> bool:
    """Return whether a joint can be a shape coordinate: revolute or prismatic."""
    group = motion_group(joint)
    return group is not None and group.dim == 1


def is_prismatic(joint: pin.JointModel) -> bool:
    """Return whether a joint is prismatic (metres), not revolute (radians)."""
    group = motion_group(joint)
    return group is not None and group.dim == group.linear == 1


def axes_of(joint: pin.JointModel) -> Array:
    """Return the twists, (6, nv), by which a joint moves its body, in the body's frame."""
    if joint.shortname() == "JointModelComposite":  # Its axes are known only after it has moved.
        model = pin.Model()
        model.addJoint(0, joint, pin.SE3.Identity(), "joint")
        data = model.createData()
        pin.computeJointJacobians(model, data, pin.neutral(model))
        return np.array(data.joints[1].S).reshape(6, joint.nv)
    return np.array(joint.createData().S).reshape(6, joint.nv)


def joint_configuration(joint: pin.JointModel, value: float) -> list[float]:
    """Return Pinocchio's coordinates of a joint with one degree of freedom at a value."""
    return [value] if joint.nq == 1 else [float(np.cos(value)), float(np.sin(value))]


def joint_units(model: pin.Model) -> tuple[str, ...]:
    """Return the units of all joints behind the root: "m" if prismatic, "rad" if revolute."""
    return tuple("m" if is_prismatic(model.joints[i]) else "rad" for i in range(2, model.njoints))


def root_joint(group: Group) -> pin.JointModel:
    """Return the joint that makes a body float in `group`.

    On the axes of the root link, ℝ is a slide along x and SO(2) a rotation about z.  SE(2) moves
    in the xy plane, and ℝ × SE(2) along z as well.
    """
    kinds = [getattr(pin, f"JointModel{kind}")() for kind in group.joints[0].split("+")]
    if len(kinds) == 1:
        return kinds[0]
    composite = pin.JointModelComposite()
    for kind in kinds:
        composite.addJoint(kind)
    return composite
