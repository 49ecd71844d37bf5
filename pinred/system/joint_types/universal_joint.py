"""Universal joints: two hinges, the second of which is carried by the first."""

from __future__ import annotations

import pinocchio as pin

from .joint_type import JointType, Part, part


def _parts(joint: pin.JointModel) -> tuple[Part, ...]:
    universal = joint.extract()
    hinges = (pin.JointModelRevoluteUnaligned(axis) for axis in (universal.axis1, universal.axis2))
    return tuple(part(suffix, hinge) for suffix, hinge in zip("12", hinges, strict=True))


UNIVERSAL = JointType("universal", ("Universal",), _parts)
