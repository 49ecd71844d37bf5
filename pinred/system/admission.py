"""Admission: the models that pinred reduces, and the refusal, by name, of all others.

The rules make the mass matrix positive definite at every shape: each body carries a
positive definite inertia and each joint moves it in an independent direction.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..common.errors import ModelError
from ..lie.group import Group
from ..lie.groups import GROUPS
from .joints import is_shape_joint, joint_kind, motion_group

_TRIANGLE_SLACK = 1e-9  # a flat body meets the triangle inequality with equality, up to round-off
_UNIT = 1e-9  # by how much an axis may miss length one
_ZERO_MOMENT = 1e-14  # principal moment over the largest, below which it is round-off


def admit(model: pin.Model) -> Group:
    """Return the symmetry group of a model whose joint 1 is the root.

    Raises ModelError, naming the joint or link and the way out, if pinred cannot reduce it.
    """
    group = _root_group(model)
    _admit_order(model)
    for i in range(2, model.njoints):
        _admit_shape_joint(model, i)
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    for i in range(1, model.njoints):
        _admit_geometry(model, data, i)
        _admit_body(model, i)
    _admit_numbers(model, group)
    return group


def refuse_mimicking(model: pin.Model) -> None:
    """Raise ModelError if joints of the model follow others."""
    if len(model.mimicking_joints):
        names = [model.names[i] for i in model.mimicking_joints]
        raise ModelError(
            f"mimic joints are not supported: {', '.join(names)}; build the model without them"
        )


def _root_group(model: pin.Model) -> Group:
    refuse_mimicking(model)
    group = motion_group(model.joints[1])
    if group is None:
        *names, last = GROUPS
        raise ModelError(
            f"root joint '{model.names[1]}' is of kind {joint_kind(model.joints[1])}; a root moves "
            f"in {', '.join(names)} or {last} ({', '.join(g.root for g in GROUPS.values())})"
        )
    return group


def _admit_order(model: pin.Model) -> None:
    """Refuse joints out of depth-first order, for which Pinocchio's crba is silently wrong."""
    if model.check(model.createData()):
        return
    names = ", ".join(list(model.names)[1:])
    raise ModelError(
        f"the joints of '{model.name}' ({names}) are not in depth-first order, which Pinocchio's "
        "algorithms need: add all joints of one branch before those of the next"
    )


def _admit_shape_joint(model: pin.Model, i: int) -> None:
    name, joint = model.names[i], model.joints[i]
    if model.parents[i] == 0:
        raise ModelError(
            f"joint '{name}' hangs on the fixed world beside the root '{model.names[1]}', "
            "so moving the root does not move the whole system; "
            "hang it on a moving link or lock it"
        )
    if not is_shape_joint(joint):
        kind = joint_kind(joint)
        split = "split it into such joints with a small body between, " if joint.nv > 1 else ""
        raise ModelError(
            f"joint '{name}' is of kind {kind} with {joint.nv} degrees of freedom; shape joints "
            f"are revolute or prismatic: {split}or lock it"
        )


def _admit_geometry(model: pin.Model, data: pin.Data, i: int) -> None:
    """Refuse a joint without a unit axis, or at a place that is not finite."""
    name = model.names[i]
    R = model.jointPlacements[i].rotation
    if not np.isfinite(model.jointPlacements[i].homogeneous).all():
        raise ModelError(f"the placement of joint '{name}' is not finite")
    if np.abs(R.T @ R - np.eye(3)).max() > _UNIT:
        raise ModelError(f"the placement of joint '{name}' is not a rotation:\n{R}")
    lengths = np.linalg.norm(np.array(data.joints[i].S).reshape(6, -1), axis=0)
    if not (np.abs(lengths - 1.0) <= _UNIT).all():
        raise ModelError(f"the axis of joint '{name}' has length {lengths[0]:g}; give it length 1")


def _admit_body(model: pin.Model, i: int) -> None:
    links = [f.name for f in model.frames if f.parentJoint == i and f.type == pin.FrameType.BODY]
    who = f"link '{links[0]}'" if links else "the body"
    if len(links) > 1:
        who += f" (with {', '.join(links[1:4])}{', …' if len(links) > 4 else ''})"
    who += f" moved by joint '{model.names[i]}'"
    mass, inertia = model.inertias[i].mass, model.inertias[i].inertia
    if not all(np.isfinite(a).all() for a in (mass, inertia, model.inertias[i].lever)):
        raise ModelError(f"{who} has an inertia that is not finite")
    if mass <= 0.0:
        what = "no mass" if mass == 0.0 else f"negative mass {mass:g}"
        way_out = "give it a positive mass" + (", or lock the joint" if i > 1 else "")
        raise ModelError(f"{who} has {what}; {way_out}")
    least, middle, most = np.linalg.eigvalsh(inertia)
    moments = f"principal moments of inertia {least:.6g}, {middle:.6g}, {most:.6g}"
    if least <= _ZERO_MOMENT * most:
        raise ModelError(f"{who} has {moments}; all three must be positive")
    if most > (least + middle) * (1.0 + _TRIANGLE_SLACK):
        raise ModelError(
            f"{who} has {moments}; the largest exceeds the sum of the others "
            "(triangle inequality), which no distribution of mass can have"
        )


def _admit_numbers(model: pin.Model, group: Group) -> None:
    for name, values in (("gravity", model.gravity.vector), ("armature", model.armature)):
        if not np.isfinite(values).all():
            raise ModelError(f"the model's {name} is not finite: {values}")
    if model.gravity.angular.any():
        raise ModelError(f"the model's gravity turns: {model.gravity.vector}; it must be linear")
    if (model.armature < 0.0).any():
        raise ModelError(f"armature must not be negative: {model.armature}")
    if (group.dim > 1 or group.linear) and model.armature[: group.dim].any():
        raise ModelError(
            f"root joint '{model.names[1]}' has armature {model.armature[: group.dim]}, which only "
            "a root that turns about one axis (SO2) can have; set it to zero, or add it to the "
            "inertia of the root link"
        )
