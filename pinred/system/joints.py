"""Classify Pinocchio joints: root joints that move in a group, and shape joints.

Consecutive joints at the root can form one joint of a group.  Examples are a planar joint and a
slide along its normal, two slides and a hinge normal to them, or three slides and three hinges.
The links between them are massless, so only the motion of the last link matters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..lie.group import Group
from ..lie.groups import GROUPS, SE3
from .elementary_joints import elementary_joint
from .shape_space import ShapeSpace, shape_space

_ALONG = 1e-9  # largest round-off in the direction of a unit twist along a group axis
_INDEPENDENT = 1e-6  # smallest singular value of six linearly independent unit twists


def joint_kind(joint: pin.JointModel) -> str:
    """Return Pinocchio's name of a joint type; join the components of a composite with "+"."""
    type_name = str(joint.shortname()).removeprefix("JointModel")
    if type_name != "Composite":
        return type_name
    composite = joint.extract()
    shifted = any(not place.isIdentity() for place in composite.jointPlacements)
    return type_name if shifted else "+".join(map(joint_kind, composite.joints))


def motion_group(joint: pin.JointModel) -> Group | None:
    """Return the symmetry group of a joint's motion, or None if the motion does not form one."""
    type_name = joint_kind(joint)
    return next((group for group in GROUPS.values() if type_name in group.joints), None)


def is_shape_joint(joint: pin.JointModel) -> bool:
    """Return whether a joint is a hinge, a slide or a ball, and so can be part of the shape."""
    return elementary_joint(joint) is not None


def is_ball(joint: pin.JointModel) -> bool:
    """Return whether the coordinates of a joint are a unit quaternion (x, y, z, w)."""
    kind = elementary_joint(joint)
    return kind is not None and kind.is_ball


def is_prismatic(joint: pin.JointModel) -> bool:
    """Return whether a joint is prismatic (metres), not revolute (radians)."""
    group = motion_group(joint)
    return group is not None and group.dim == group.linear == 1


def axes_of(joint: pin.JointModel) -> Array:
    """Return the unit twists of a joint's degrees of freedom, (6, nv), in the body's frame."""
    if joint.shortname() == "JointModelComposite":  # Pinocchio computes its axes with its motion.
        model = pin.Model()
        model.addJoint(0, joint, pin.SE3.Identity(), "joint")
        data = model.createData()
        pin.computeJointJacobians(model, data, pin.neutral(model))
        return np.array(data.joints[1].S).reshape(6, joint.nv)
    return np.array(joint.createData().S).reshape(6, joint.nv)


def joint_configuration(joint: pin.JointModel, value: float) -> list[float]:
    """Convert the value of a joint with one degree of freedom to Pinocchio's coordinates."""
    return [value] if joint.nq == 1 else [float(np.cos(value)), float(np.sin(value))]


def tree_space(model: pin.Model) -> ShapeSpace:
    """Return the manifold of all joints except the root.  They are hinges, slides and balls."""
    joints = [model.joints[i] for i in range(2, model.njoints)]
    kinds = [elementary for joint in joints if (elementary := elementary_joint(joint)) is not None]
    return shape_space([str(name) for name in model.names[2:]], kinds)


def root_joint(group: Group) -> pin.JointModel:
    """Return the joint that makes a body float in `group`.

    In the axes of the root link, ℝ slides along x and SO(2) rotates about z.  SE(2) moves in the
    xy plane, and ℝ × SE(2) also moves along z.
    """
    kinds = [getattr(pin, f"JointModel{joint}")() for joint in group.joints[0].split("+")]
    if len(kinds) == 1:
        return kinds[0]
    composite = pin.JointModelComposite()
    for joint in kinds:
        composite.addJoint(joint)
    return composite


@dataclass(frozen=True)
class RootChain:
    """Consecutive joints at the root that together move in a group.

    Attributes:
        group: Group of the motion.
        last: Index of the chain's last joint; the chain starts at joint 1.
        at: Placement of the equivalent root joint in the world.
        armature: Armature along the axes of the group, (r,) [kg m² | kg].
    """

    group: Group
    last: int
    at: pin.SE3
    armature: Array


def root_chain(raw: pin.Model) -> RootChain | None:
    """Return the chain at the root of a model, or None if its joints do not form a group."""
    last = _end_of_chain(raw)
    if last < 2 or any(motion_group(raw.joints[i]) is None for i in range(1, last + 1)):
        return None
    chain = pin.Model()
    for i in range(1, last + 1):
        chain.addJoint(i - 1, raw.joints[i], raw.jointPlacements[i], raw.names[i])
    data, nv = chain.createData(), chain.nv
    pin.computeJointJacobians(chain, data, pin.neutral(chain))
    if nv == 6 and np.linalg.matrix_rank(data.J, tol=_INDEPENDENT) == 6:
        return RootChain(SE3, last, data.oMi[last].copy(), raw.armature[:6].copy())
    for joint in range(last, 0, -1):
        at = data.oMi[joint].copy()
        twists = at.toActionMatrixInverse() @ data.J[:, :nv]
        for group in GROUPS.values():
            in_group = np.abs(twists[list(group.axes)])
            if group.dim == nv and _is_permutation(in_group) and _is_permutation(np.abs(twists)):
                return RootChain(group, last, at, np.rint(in_group) @ raw.armature[:nv])
    return None


def places_on_root(raw: pin.Model, chain: RootChain) -> dict[str, pin.SE3]:
    """Return {joint: placement of its body on the equivalent root joint} of a chain."""
    places, at = {}, pin.SE3.Identity()
    for i in range(1, chain.last + 1):
        at = at * raw.jointPlacements[i]
        places[str(raw.names[i])] = chain.at.actInv(at)
    return places


def _end_of_chain(raw: pin.Model) -> int:
    """Return the last joint before which every link is massless and carries only one joint."""
    last, parents = 0, list(raw.parents)[1:]
    children: dict[int, list[int]] = {}
    for i, parent in enumerate(parents, start=1):
        children.setdefault(parent, []).append(i)
    while raw.inertias[last].mass == 0.0 and len(children.get(last, ())) == 1:
        (last,) = children[last]
    return last


def _is_permutation(matrix: Array) -> bool:
    """Return whether each column is a coordinate axis and no axis occurs twice."""
    rounded = np.rint(matrix)
    once = (rounded.sum(axis=0) == 1.0).all() and (rounded.sum(axis=1) <= 1.0).all()
    return bool(once and np.abs(matrix - rounded).max() <= _ALONG)
