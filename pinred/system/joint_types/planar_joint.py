"""Planar joints: slides along x and y, then a hinge about z.

The linear velocity of Pinocchio's joint has components in the axes of the child.  The rates of the
slides are components in the axes of the parent.
"""

from __future__ import annotations

import pinocchio as pin

from .joint_type import JointType, Part, part


def _parts(_: pin.JointModel) -> tuple[Part, ...]:
    return (
        part("x", pin.JointModelPX(), rotated=True),
        part("y", pin.JointModelPY(), rotated=True),
        part("turn", pin.JointModelRUBZ()),
    )


PLANAR = JointType("planar", ("Planar",), _parts)
