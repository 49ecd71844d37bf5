"""JointType: a joint as a product of hinges, slides and balls."""

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
