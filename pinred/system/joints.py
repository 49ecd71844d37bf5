"""Pinocchio's joints as pinred reads them: the group of a root joint, the joints of the shape."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..lie.groups import SE2, SE3, SO2, SO3, Group, R

# "RUB" is Pinocchio's name for a revolute joint without limits: its coordinates are (cos, sin).
_REVOLUTE = frozenset(
    f"JointModel{kind}"
    for kind in (
        *("RX", "RY", "RZ", "RevoluteUnaligned"),
        *("RUBX", "RUBY", "RUBZ", "RevoluteUnboundedUnaligned"),
    )
)
_PRISMATIC = frozenset(f"JointModel{kind}" for kind in ("PX", "PY", "PZ", "PrismaticUnaligned"))
_MANY = {"JointModelPlanar": SE2, "JointModelSpherical": SO3, "JointModelFreeFlyer": SE3}


def motion_group(joint: pin.JointModel) -> Group | None:
    """Return the group in which a joint moves its body, or None if it is none of the five."""
    kind = joint.shortname()
    if kind in _REVOLUTE:
        return SO2
    return R if kind in _PRISMATIC else _MANY.get(kind)


def is_shape_joint(joint: pin.JointModel) -> bool:
    """Return whether a joint can be a shape coordinate: revolute or prismatic."""
    return motion_group(joint) in (R, SO2)


def is_prismatic(joint: pin.JointModel) -> bool:
    """Return whether a joint slides (metres) rather than turns (radians)."""
    return joint.shortname() in _PRISMATIC


def axes_of(joint: pin.JointModel) -> Array:
    """Return the twists, (6, nv), by which a joint moves its body, in the body's frame."""
    return np.array(joint.createData().S).reshape(6, joint.nv)


def shape_units(model: pin.Model) -> tuple[str, ...]:
    """Return the unit of each shape coordinate: m of those that slide, rad of those that turn."""
    return tuple("m" if is_prismatic(model.joints[i]) else "rad" for i in range(2, model.njoints))


def root_joint(group: Group) -> pin.JointModel:
    """Return the joint that makes a body float in `group`.

    ℝ slides along x and SO(2) turns about z of the root link; SE(2) moves in its xy plane.
    """
    if group is R:
        return pin.JointModelPX()
    if group is SO2:
        return pin.JointModelRZ()
    if group is SE2:
        return pin.JointModelPlanar()
    return pin.JointModelSpherical() if group is SO3 else pin.JointModelFreeFlyer()
