"""Screw joints: a hinge, and a slide along the same axis that follows it.

The joint's value is the angle of the hinge.  The slide moves by the pitch per radian.
"""

from __future__ import annotations

import pinocchio as pin

from .joint_type import JointType, Part, part

_ALIGNED = {
    "JointModelHX": (pin.JointModelRX, pin.JointModelPX),
    "JointModelHY": (pin.JointModelRY, pin.JointModelPY),
    "JointModelHZ": (pin.JointModelRZ, pin.JointModelPZ),
}


def _parts(joint: pin.JointModel) -> tuple[Part, ...]:
    screw = joint.extract()
    if joint.shortname() in _ALIGNED:
        hinge, slide = (kind() for kind in _ALIGNED[joint.shortname()])
    else:
        hinge = pin.JointModelRevoluteUnaligned(screw.axis)
        slide = pin.JointModelPrismaticUnaligned(screw.axis)
    return part("", hinge), part("slide", slide, float(screw.pitch))


SCREW = JointType("screw", ("HX", "HY", "HZ", "HelicalUnaligned"), _parts)
