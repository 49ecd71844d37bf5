"""Joint types with several degrees of freedom as products of hinges, slides and balls.

A joint is a product if its motion can be carried out by its parts, one after the other.
`split_joints` replaces such joints when a model is loaded.  This is exact: the massless bodies
between the parts add no inertia.  A new type is one more entry of `JOINT_TYPES`.

Pinocchio's derivatives of the mass matrix are wrong for joints whose axes vary with q within the
joint (Universal, SphericalZYX, and composites).  These joints never reach them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import pinocchio as pin


@dataclass(frozen=True, eq=False)
class Part:
    """A hinge, slide or ball of a joint.

    Attributes:
        suffix: Suffix of its name: the part of joint "wrist" is "wrist.suffix".  The part that
            keeps the name of the joint has no suffix.
        joint: Revolute, prismatic or spherical joint.
        placement: Placement on the body of the part before.
        ratio: Displacement per displacement of the part before, if the part follows it; else None.
        rotated: Whether the joint's rate along the part is a component of a vector in the axes of
            the child.  Armature and damping are constant along the part only if they are equal
            for all such components.
    """

    suffix: str
    joint: pin.JointModel
    placement: pin.SE3
    ratio: float | None = None
    rotated: bool = False


@dataclass(frozen=True)
class JointType:
    """A kind of joints, and the hinges, slides and balls of which they consist.

    Attributes:
        name: Name of the type.
        kinds: Pinocchio's names of the joints, without "JointModel".
        parts: Function that returns the parts of a joint, from the parent to the child.  The
            coordinates of independent parts are, in this order, those of the joint.
    """

    name: str
    kinds: tuple[str, ...]
    parts: Callable[[pin.JointModel], tuple[Part, ...]]


def part(
    suffix: str, joint: pin.JointModel, ratio: float | None = None, *, rotated: bool = False
) -> Part:
    """Return a part at the origin of the part before.

    Args:
        suffix: Suffix of its name.
        joint: Revolute, prismatic or spherical joint.
        ratio: Displacement per displacement of the part before, or None.
        rotated: See Part.
    Returns:
        The part.
    """
    return Part(suffix, joint, pin.SE3.Identity(), ratio, rotated)


def _euler_angles(_: pin.JointModel) -> tuple[Part, ...]:
    """Return yaw about z, pitch about y and roll about x."""
    return (
        part("yaw", pin.JointModelRZ()),
        part("pitch", pin.JointModelRY()),
        part("roll", pin.JointModelRX()),
    )


def _free(_: pin.JointModel) -> tuple[Part, ...]:
    """Return slides along x, y and z, then a ball.

    The linear velocity of Pinocchio's joint has components in the axes of the child.  The rates of
    the slides are components in the axes of the parent.  The ball has the quaternion and the
    angular velocity of the joint.
    """
    return (
        part("x", pin.JointModelPX(), rotated=True),
        part("y", pin.JointModelPY(), rotated=True),
        part("z", pin.JointModelPZ(), rotated=True),
        part("ball", pin.JointModelSpherical()),
    )


def _planar(_: pin.JointModel) -> tuple[Part, ...]:
    """Return slides along x and y, then a hinge about z.

    The linear velocity of Pinocchio's joint has components in the axes of the child.  The rates of
    the slides are components in the axes of the parent.
    """
    return (
        part("x", pin.JointModelPX(), rotated=True),
        part("y", pin.JointModelPY(), rotated=True),
        part("turn", pin.JointModelRUBZ()),
    )


_ALIGNED = {
    "JointModelHX": (pin.JointModelRX, pin.JointModelPX),
    "JointModelHY": (pin.JointModelRY, pin.JointModelPY),
    "JointModelHZ": (pin.JointModelRZ, pin.JointModelPZ),
}


def _screw(joint: pin.JointModel) -> tuple[Part, ...]:
    """Return a hinge, and a slide along the same axis that follows it.

    The joint's value is the angle of the hinge.  The slide moves by the pitch per radian.
    """
    screw = joint.extract()
    if joint.shortname() in _ALIGNED:
        hinge, slide = (kind() for kind in _ALIGNED[joint.shortname()])
    else:
        hinge = pin.JointModelRevoluteUnaligned(screw.axis)
        slide = pin.JointModelPrismaticUnaligned(screw.axis)
    return part("", hinge), part("slide", slide, float(screw.pitch))


def _translation(_: pin.JointModel) -> tuple[Part, ...]:
    """Return slides along x, y and z."""
    slides = (pin.JointModelPX(), pin.JointModelPY(), pin.JointModelPZ())
    return tuple(part(suffix, slide) for suffix, slide in zip("xyz", slides, strict=True))


def _universal(joint: pin.JointModel) -> tuple[Part, ...]:
    """Return two hinges, the second of which is carried by the first."""
    universal = joint.extract()
    hinges = (pin.JointModelRevoluteUnaligned(axis) for axis in (universal.axis1, universal.axis2))
    return tuple(part(suffix, hinge) for suffix, hinge in zip("12", hinges, strict=True))


JOINT_TYPES = (
    JointType("Euler angles", ("SphericalZYX",), _euler_angles),
    JointType("free", ("FreeFlyer",), _free),
    JointType("planar", ("Planar",), _planar),
    JointType("screw", ("HX", "HY", "HZ", "HelicalUnaligned"), _screw),
    JointType("translation", ("Translation",), _translation),
    JointType("universal", ("Universal",), _universal),
)
