"""Joints that translate in space: slides along x, y and z."""

from __future__ import annotations

import pinocchio as pin

from .joint_type import JointType, Part, part


def _parts(_: pin.JointModel) -> tuple[Part, ...]:
    slides = (pin.JointModelPX(), pin.JointModelPY(), pin.JointModelPZ())
    return tuple(part(suffix, slide) for suffix, slide in zip("xyz", slides, strict=True))


TRANSLATION = JointType("translation", ("Translation",), _parts)
