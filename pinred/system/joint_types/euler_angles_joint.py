"""Joints with three Euler angles: yaw about z, pitch about y, roll about x."""

from __future__ import annotations

import pinocchio as pin

from .joint_type import JointType, Part, part


def _parts(_: pin.JointModel) -> tuple[Part, ...]:
    return (
        part("yaw", pin.JointModelRZ()),
        part("pitch", pin.JointModelRY()),
        part("roll", pin.JointModelRX()),
    )


EULER_ANGLES = JointType("Euler angles", ("SphericalZYX",), _parts)
