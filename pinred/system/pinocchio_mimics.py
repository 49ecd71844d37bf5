"""Pinocchio's mimic joints as plain joints and couplings: its ABA knows none."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..common.errors import ModelError
from ..common.plain_names import quoted
from .contents import Coupling

_AXES = {
    "prismatic": (
        (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ), pin.JointModelPrismaticUnaligned,
    ),
    "revolute": (
        (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ), pin.JointModelRevoluteUnaligned,
    ),
}  # fmt: skip
_ANY = 1e-9  # below which a part of an axis of length one is round-off


def plain_joints(model: pin.Model) -> tuple[pin.Model, tuple[Coupling, ...]]:
    """Return a copy of a model with plain joints for its mimic joints, and how these follow.

    Pinocchio drops the armature and the limits of a joint that it makes a mimic joint.  Raises
    ModelError for one whose scaling is zero, which has lost its axis.
    """
    followers = list(model.mimicking_joints)
    if not followers:
        return model.copy(), ()
    out = pin.Model()
    out.name, out.gravity = model.name, model.gravity
    out.inertias[0] = model.inertias[0]
    armature, lower, upper, couplings = [], [], [], []
    for i in range(1, model.njoints):
        joint = model.joints[i]
        if i in followers:
            couplings.append(_coupling(model, i))
            joint = _unscaled(model, i)
            armature.append([0.0])
            lower.append([-np.inf])
            upper.append([np.inf])
        else:
            qs = slice(joint.idx_q, joint.idx_q + joint.nq)
            armature.append(model.armature[joint.idx_v : joint.idx_v + joint.nv])
            lower.append(model.lowerPositionLimit[qs])
            upper.append(model.upperPositionLimit[qs])
        k = out.addJoint(model.parents[i], joint, model.jointPlacements[i], model.names[i])
        out.appendBodyToJoint(k, model.inertias[i], pin.SE3.Identity())
    for frame in list(model.frames)[1:]:
        out.addFrame(
            pin.Frame(frame.name, frame.parentJoint, 0, frame.placement, frame.type), False
        )
    out.armature = np.concatenate(armature)
    out.lowerPositionLimit, out.upperPositionLimit = np.concatenate(lower), np.concatenate(upper)
    return out, tuple(couplings)


def _coupling(model: pin.Model, i: int) -> Coupling:
    mimic = model.joints[i].extract()
    leader = next(
        k
        for k in range(1, model.njoints)
        if k not in list(model.mimicking_joints) and model.joints[k].idx_v == mimic.idx_v
    )
    ratio, offset = float(mimic.scaling), float(mimic.offset)
    return Coupling(model.names[i], model.names[leader], ratio, offset)


def _unscaled(model: pin.Model, i: int) -> pin.JointModel:
    """Return the joint that a mimic joint was made of, from its axis."""
    joint, scaling = model.joints[i], float(model.joints[i].extract().scaling)
    moved = joint.createData()
    joint.calc(moved, pin.neutral(model))
    twist = np.array(moved.S).ravel()
    if scaling == 0.0 or not np.isfinite(twist).all() or not twist.any():
        raise ModelError(
            f"mimic joint {quoted(model.names[i])} has scaling {scaling:g}, so that Pinocchio "
            "keeps no axis of it; build the model without it, or with a fixed joint"
        )
    slides = not twist[3:].any()
    aligned, other = _AXES["prismatic" if slides else "revolute"]
    axis = (twist[:3] if slides else twist[3:]) / scaling
    k = int(np.argmax(np.abs(axis)))
    if np.abs(axis - np.eye(3)[k]).max() <= _ANY:
        return aligned[k]()
    return other(axis / np.linalg.norm(axis))
