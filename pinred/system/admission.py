"""Admission: the models that pinred reduces, and the refusal, by name, of all others.

A tree of revolute and prismatic joints hangs on a root that moves in one of five groups; its
mass matrix is regular at nearly all shapes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ..common.errors import ModelError
from ..common.plain_names import listed, quoted
from ..lie.group import Group
from ..lie.groups import GROUPS
from .coupling import Coupled
from .inertias import check_inertias
from .joints import axes_of, is_shape_joint, joint_kind, motion_group

_UNIT = 1e-9  # by how much an axis may miss length one
_MOST = 400  # degrees of freedom
_CUBE = 33.0  # bytes of Pinocchio's work space, over the cube of the degrees of freedom


@dataclass(frozen=True)
class Admission:
    """The findings when a model is let in.

    group: the symmetry.  doubts: sentences about what only no real robot has, or what makes the
    mass matrix singular at single shapes.
    """

    group: Group
    doubts: tuple[str, ...]


def admit(model: pin.Model, coupled: Coupled | None = None) -> Admission:
    """Return the symmetry group of a model whose joint 1 is the root, and what is doubtful.

    The joints are in depth-first order.  coupled: how they follow each other, if some do.  Raises
    ModelError, naming the joint or link and the way out, if pinred cannot reduce it.
    """
    group = _root_group(model)
    _admit_size(model)
    _admit_names(model)
    for i in range(2, model.njoints):
        _admit_shape_joint(model, i)
    for i in range(1, model.njoints):
        _admit_geometry(model, i)
    _admit_numbers(model, group)
    return Admission(group, check_inertias(model, coupled))


def _root_group(model: pin.Model) -> Group:
    if len(model.mimicking_joints):
        names = [model.names[i] for i in model.mimicking_joints]
        raise ModelError(
            f"a System takes no mimic joints of Pinocchio's, such as {listed(names)}; pinred.load "
            "makes couplings of them"
        )
    group = motion_group(model.joints[1])
    if group is None:
        *names, last = GROUPS
        raise ModelError(
            f"root joint {quoted(model.names[1])} is of kind {joint_kind(model.joints[1])}; a root "
            f"moves in {', '.join(names)} or {last} ({', '.join(g.root for g in GROUPS.values())})"
        )
    return group


def _admit_size(model: pin.Model) -> None:
    if model.nv > _MOST:
        raise ModelError(
            f"the model has {model.nv} degrees of freedom, more than {_MOST}: each work space of "
            f"Pinocchio for it, of which a run needs several, would take "
            f"{_CUBE * float(model.nv) ** 3 / 1e9:.3g} GB; lock joints that need not move"
        )


def _admit_names(model: pin.Model) -> None:
    names = list(model.names)
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise ModelError(f"several joints are called {quoted(twice)}; give each a name of its own")


def _admit_shape_joint(model: pin.Model, i: int) -> None:
    name, joint = model.names[i], model.joints[i]
    if model.parents[i] == 0:
        raise ModelError(
            f"joint {quoted(name)} hangs on the fixed world beside the root "
            f"{quoted(model.names[1])}, so moving the root does not move the whole system; "
            "hang it on a moving link or lock it"
        )
    if not is_shape_joint(joint):
        kind = joint_kind(joint)
        split = "split it into such joints with bodies without mass between, "
        raise ModelError(
            f"joint {quoted(name)} is of kind {kind} with {joint.nv} degrees of freedom; shape "
            f"joints are revolute or prismatic: {split if joint.nv > 1 else ''}or lock it"
        )


def _admit_geometry(model: pin.Model, i: int) -> None:
    """Refuse a joint without a unit axis, or at a place that is not finite."""
    name = model.names[i]
    R = model.jointPlacements[i].rotation
    if not np.isfinite(model.jointPlacements[i].homogeneous).all():
        raise ModelError(f"the placement of joint {quoted(name)} is not finite")
    if np.abs(R.T @ R - np.eye(3)).max() > _UNIT:
        raise ModelError(f"the placement of joint {quoted(name)} is not a rotation:\n{R}")
    lengths = np.linalg.norm(axes_of(model.joints[i]), axis=0)
    if not (np.abs(lengths - 1.0) <= _UNIT).all():
        raise ModelError(
            f"the axis of joint {quoted(name)} has length {lengths[0]:g}; give it length 1"
        )


def _admit_numbers(model: pin.Model, group: Group) -> None:
    for name, values in (("gravity", model.gravity.vector), ("armature", model.armature)):
        if not np.isfinite(values).all():
            raise ModelError(f"the model's {name} is not finite: {values}")
    if model.gravity.angular.any():
        raise ModelError(f"the model's gravity turns: {model.gravity.vector}; it must be linear")
    if (model.armature < 0.0).any():
        raise ModelError(f"armature must not be negative: {model.armature}")
    rotor = model.armature[: group.dim]
    if (group.dim > 1 or group.linear) and rotor.any():
        raise ModelError(
            f"root joint {quoted(model.names[1])} has armature {rotor}, which only a root that "
            "turns about one axis (SO2) can have; set it to zero, or add it to the inertia of the "
            "root link"
        )
