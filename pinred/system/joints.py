"""Pinocchio's joints as pinred reads them: the group of a root joint, the joints of the shape."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..lie.group import Group
from ..lie.groups import GROUPS


def joint_kind(joint: pin.JointModel) -> str:
    """Return what Pinocchio calls a joint; of a composite one, its parts, joined by "+"."""
    kind = str(joint.shortname()).removeprefix("JointModel")
    if kind != "Composite":
        return kind
    parts = joint.extract()
    apart = any(not place.isIdentity() for place in parts.jointPlacements)
    return kind if apart else "+".join(map(joint_kind, parts.joints))


def motion_group(joint: pin.JointModel) -> Group | None:
    """Return the group in which a joint moves its body, or None if it is none that is known."""
    kind = joint_kind(joint)
    return next((group for group in GROUPS.values() if kind in group.joints), None)


def is_shape_joint(joint: pin.JointModel) -> bool:
    """Return whether a joint can be a shape coordinate: revolute or prismatic."""
    group = motion_group(joint)
    return group is not None and group.dim == 1


def is_prismatic(joint: pin.JointModel) -> bool:
    """Return whether a joint slides (metres) rather than turns (radians)."""
    group = motion_group(joint)
    return group is not None and group.dim == group.linear == 1


def axes_of(joint: pin.JointModel) -> Array:
    """Return the twists, (6, nv), by which a joint moves its body, in the body's frame."""
    if joint.shortname() == "JointModelComposite":  # knows its axes when it has been moved
        alone = pin.Model()
        alone.addJoint(0, joint, pin.SE3.Identity(), "alone")
        data = alone.createData()
        pin.computeJointJacobians(alone, data, pin.neutral(alone))
        return np.array(data.joints[1].S).reshape(6, joint.nv)
    return np.array(joint.createData().S).reshape(6, joint.nv)


def joint_units(model: pin.Model) -> tuple[str, ...]:
    """Return the unit of each joint behind the root: m if it slides, rad if it turns."""
    return tuple("m" if is_prismatic(model.joints[i]) else "rad" for i in range(2, model.njoints))


def root_joint(group: Group) -> pin.JointModel:
    """Return the joint that makes a body float in `group`.

    ℝ slides along x and SO(2) turns about z of the root link; SE(2) moves in its xy plane,
    and ℝ × SE(2) along its z as well.
    """
    parts = [getattr(pin, f"JointModel{kind}")() for kind in group.joints[0].split("+")]
    if len(parts) == 1:
        return parts[0]
    whole = pin.JointModelComposite()
    for part in parts:
        whole.addJoint(part)
    return whole
