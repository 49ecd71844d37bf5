"""Free joints inside the tree: slides along x, y and z, then a ball.

The linear velocity of Pinocchio's joint has components in the axes of the child.  The rates of the
slides are components in the axes of the parent.  The ball has the quaternion and the angular
velocity of the joint.
"""

from __future__ import annotations

import pinocchio as pin

from .joint_type import JointType, Part, part


def _parts(_: pin.JointModel) -> tuple[Part, ...]:
    return (
        part("x", pin.JointModelPX(), rotated=True),
        part("y", pin.JointModelPY(), rotated=True),
        part("z", pin.JointModelPZ(), rotated=True),
        part("ball", pin.JointModelSpherical()),
    )


FREE = JointType("free", ("FreeFlyer",), _parts)
