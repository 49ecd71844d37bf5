"""Admission of models: which models pinred can reduce, and error messages for all others.

pinred reduces trees of hinges, slides and balls whose root moves in one of the groups.  It
rejects invalid numbers (infinite values, negative masses or moments) and mass matrices that are
singular at every shape.  Inertias that no mass distribution has, and mass matrices that are
singular at isolated shapes, cause warnings (`doubts`).
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..common.errors import ModelError
from ..common.names import listed, quoted
from ..lie.group import Group
from ..lie.groups import GROUPS
from .coupling import Coupled
from .joints import axes_of, is_prismatic, is_shape_joint, joint_kind, largest_step, motion_group
from .singular_mass_matrix import SingularShape, no_moment, singular_shapes

_UNIT = 1e-9  # tolerance for the unit length of an axis and the orthogonality of a rotation
_MOST_FREEDOMS = 400
# Memory of one Pinocchio work space (pin.Data), divided by the cube of the degrees of freedom
# [byte].
WORKSPACE_BYTES = 33.0
_HUGE = 1e100  # largest accepted mass, moment or length [kg, kg m², m]; larger products overflow
# A flat body satisfies the triangle inequality with equality, up to this relative round-off.
_TRIANGLE_SLACK = 1e-9


def check_joints(model: pin.Model) -> None:
    """Check the names, number and kinds of joints.

    Args:
        model: Model whose joint 1 is the root, with joints in depth-first order.
    Raises:
        ModelError: pinred cannot reduce such joints.
    """
    _root_group(model)
    if model.nv > _MOST_FREEDOMS:
        raise ModelError(
            f"the model has {model.nv} degrees of freedom, more than {_MOST_FREEDOMS}: each work "
            "space of Pinocchio for it, of which a run needs several, would take "
            f"{WORKSPACE_BYTES * float(model.nv) ** 3 / 1e9:.3g} GB; "
            "lock joints that are not needed"
        )
    names = list(model.names)
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise ModelError(f"several joints are called {quoted(twice)}; give each a unique name")
    for i in range(2, model.njoints):
        _admit_shape_joint(model, i)


def admit(
    model: pin.Model, coupled: Coupled | None = None, doubts: tuple[str, ...] | None = None
) -> tuple[Group, tuple[str, ...]]:
    """Check that a model can be reduced; return its symmetry group and warnings.

    Args:
        model: Model whose joints `check_joints` accepts.
        coupled: Dependence of follower joints on independent joints; None without followers.
        doubts: Warnings, if they are known; the inertias are then not examined.
    Returns:
        Symmetry group; and warnings, one sentence each, about inertias that no real body has and
        about shapes at which the mass matrix is singular.
    Raises:
        ModelError: pinred cannot reduce the model.  The message names the joint or link at
            fault and a remedy.
    """
    group = _root_group(model)
    for i in range(1, model.njoints):
        _admit_geometry(model, i)
    _admit_numbers(model, group)
    return group, _check_inertias(model, coupled) if doubts is None else doubts


def _root_group(model: pin.Model) -> Group:
    if len(model.mimicking_joints):
        names = [model.names[i] for i in model.mimicking_joints]
        raise ModelError(
            f"a System cannot contain Pinocchio's mimic joints, such as {listed(names)}; "
            "pinred.load converts them to couplings"
        )
    group = motion_group(model.joints[1])
    if group is None:
        *names, last = GROUPS
        raise ModelError(
            f"root joint {quoted(model.names[1])} is of kind {joint_kind(model.joints[1])}; a root "
            f"moves in {', '.join(names)} or {last} ({', '.join(g.root for g in GROUPS.values())})"
        )
    return group


def _admit_shape_joint(model: pin.Model, i: int) -> None:
    name, joint = model.names[i], model.joints[i]
    if model.parents[i] == 0:
        raise ModelError(
            f"joint {quoted(name)} is attached to the fixed world, not to root "
            f"{quoted(model.names[1])}, so moving the root does not move the whole system; "
            "attach it to a moving link or lock it"
        )
    if not is_shape_joint(joint):
        type_name = joint_kind(joint)
        raise ModelError(
            f"joint {quoted(name)} is of kind {type_name} with {joint.nv} degrees of freedom, "
            "which is not a product of hinges, slides and balls; replace it by such joints with "
            "massless bodies between them, or lock it"
        )


def _admit_geometry(model: pin.Model, i: int) -> None:
    """Reject a joint whose axis is not a unit vector or whose placement is not finite."""
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
    """Reject gravity and armature that are not finite or that break the symmetry."""
    for name, values in (("gravity", model.gravity.vector), ("armature", model.armature)):
        if not np.isfinite(values).all():
            raise ModelError(f"the model's {name} is not finite: {values}")
    if model.gravity.angular.any():
        raise ModelError(
            f"the model's gravity has an angular part: {model.gravity.vector}; it must be linear"
        )
    for i in range(1, model.njoints):
        first = model.joints[i].idx_v
        armature = model.armature[first : first + model.joints[i].nv]
        if (armature < 0.0).any():
            raise ModelError(
                f"joint {quoted(model.names[i])} has armature {armature.min():g}; it must be zero "
                "or positive"
            )
        if i == 1:
            continue
        if not (armature == armature[0]).all():
            raise ModelError(
                f"ball joint {quoted(model.names[i])} has armature {armature}; the kinetic energy "
                "is invariant only if the armature is equal about all three axes. Give it one "
                "value, or replace the ball by three hinges"
            )
    rotor = model.armature[: group.dim]
    if (group.dim > 1 or group.linear) and rotor.any():
        raise ModelError(
            f"root joint {quoted(model.names[1])} has armature {rotor}, which only a root that "
            "turns about one axis (SO2) can have; set it to zero, or add it to the inertia of the "
            "root link"
        )


def _check_inertias(model: pin.Model, coupled: Coupled | None) -> tuple[str, ...]:
    """Return warnings about the inertias; raise ModelError if they cannot be simulated."""
    unit = largest_step(model)
    for i in range(1, model.njoints):
        _check_body(model, i, unit)
    if not sum(model.inertias[i].mass for i in range(1, model.njoints)) > 0.0:
        raise ModelError(
            f"{_body_words(model, 1)} and its descendants have no mass; give one of them a mass"
        )
    singular = singular_shapes(model, coupled)
    if singular.everywhere:
        raise ModelError(_refusal(model, singular.everywhere))
    doubts = (
        _triangle_doubt(model, unit),
        _nearly_singular_doubt(model, singular.nearly),
        _isolated_shapes_doubt(model, singular.isolated),
    )
    return tuple(doubt for doubt in doubts if doubt)


def _body_words(model: pin.Model, i: int) -> str:
    """Describe the body that joint i moves by its links and its joint, for messages."""
    links = [f.name for f in model.frames if f.parentJoint == i and f.type == pin.FrameType.BODY]
    words = f"link {quoted(links[0])}" if links else "the body"
    if len(links) > 1:
        words += f" (with {listed(links[1:], 3)})"
    return f"{words} moved by joint {quoted(model.names[i])}"


def _check_body(model: pin.Model, i: int, unit: float) -> None:
    """Reject an inertia that is infinite, negative, or so large that products overflow."""
    body = model.inertias[i]
    mass, inertia = body.mass, body.inertia
    if not all(np.isfinite(a).all() for a in (mass, inertia, body.lever)):
        raise ModelError(f"{_body_words(model, i)} has an inertia that is not finite")
    largest = max(mass, float(np.abs(inertia).max()), float(np.abs(body.lever).max()))
    if largest > _HUGE:
        raise ModelError(
            f"{_body_words(model, i)} has a mass, a moment of inertia or a lever arm of "
            f"{largest:.1e}, above {_HUGE:g}, so that products overflow; use other units"
        )
    if mass < 0.0:
        raise ModelError(
            f"{_body_words(model, i)} has negative mass {mass:g}; give it a positive one, or none"
        )
    moments = np.linalg.eigvalsh(inertia)
    if moments[0] < -no_moment(body, unit):
        raise ModelError(
            f"{_body_words(model, i)} has principal moments of inertia {_shown(moments)}; "
            "all must be zero or positive"
        )


def _refusal(model: pin.Model, joints: tuple[str, ...]) -> str:
    """Return the error message for a model with joints that move no mass at any shape."""
    joints = _whole_joints(model, joints)
    i = model.getJointId(joints[0])
    body, behind = model.inertias[i], len(model.children[i]) > 0
    lacks = "no mass"
    if body.mass > 0.0:
        moments = np.linalg.eigvalsh(body.inertia)
        is_point = moments[2] <= no_moment(body, largest_step(model))
        lacks = f"its mass in one {'point' if is_point else 'line'}"
        if not is_point:
            lacks += f" (principal moments of inertia {_shown(moments)})"
    text = f"{_body_words(model, i)} has {lacks}"
    if behind:
        text += ", and its descendant joints can undo the joint's motion"
    text += ": at no shape does the joint move any mass, so the mass matrix is singular; "
    text += "give it a mass" if body.mass == 0.0 else "give it moments of inertia"
    if i > 1:
        return f"{text}, give the joint armature, or lock it: lock={list(joints)}"
    return f"{text}, or choose a smaller group"


def _triangle_doubt(model: pin.Model, unit: float) -> str:
    """Describe the bodies whose moments of inertia violate the triangle inequality."""
    bodies = []
    for i in range(1, model.njoints):
        body = model.inertias[i]
        moments = np.linalg.eigvalsh(body.inertia)
        smaller_moments = float(moments[0] + moments[1])
        if moments[2] > smaller_moments * (1.0 + _TRIANGLE_SLACK) + no_moment(body, unit):
            excess = (
                f"{100.0 * (moments[2] / smaller_moments - 1.0):.3g} %"
                if smaller_moments > 0.0
                else "all of it"
            )
            bodies.append(f"{_body_words(model, i)} by {excess} ({_shown(moments)})")
    if not bodies:
        return ""
    return (
        "no distribution of mass has these principal moments of inertia, the largest above the "
        f"sum of the others (triangle inequality): {_some(bodies)}"
    )


def _nearly_singular_doubt(model: pin.Model, joints: tuple[str, ...]) -> str:
    if not joints:
        return ""
    joints = _whole_joints(model, joints)
    body = _body_words(model, model.getJointId(joints[0]))
    return (
        f"the mass matrix is nearly singular at every shape: joint {listed(joints)} moves hardly "
        f"any mass ({body}); lock={list(joints)} locks these joints"
    )


def _whole_joints(model: pin.Model, rates: tuple[str, ...]) -> tuple[str, ...]:
    """Return the joints with the given names of rates; those of a ball end in its axes."""
    joints = (rate if model.existJointName(rate) else rate.rpartition(".")[0] for rate in rates)
    return tuple(dict.fromkeys(joints))


def _isolated_shapes_doubt(model: pin.Model, shapes: tuple[SingularShape, ...]) -> str:
    """Describe the isolated shapes at which a joint moves no mass."""
    if not shapes:
        return ""
    # Group shapes that differ only in the value of the last deciding joint.
    values: dict[tuple[str, str], list[str]] = {}
    for shape in shapes:
        *earlier_values, last = [_joint_value_words(model, *entry) for entry in shape.at.items()]
        name, _, value = last.rpartition(" = ")
        values.setdefault((shape.joint, ", ".join([*earlier_values, name])), []).append(value)
    sentences = [
        f"joint {quoted(joint)} moves no mass at {names} = {' or '.join(listing)}"
        for (joint, names), listing in values.items()
    ]
    return (
        f"the mass matrix is singular at single shapes, where a simulation ends: {_some(sentences)}"
    )


def _joint_value_words(model: pin.Model, name: str, value: float) -> str:
    # The name of an entry of a ball's rotation vector is not that of a joint.
    slides = model.existJointName(name) and is_prismatic(model.joints[model.getJointId(name)])
    unit = "m" if slides else "rad"
    return f"{quoted(name)} = {value:.6g} {unit}"


def _some(sentences: list[str], most: int = 6) -> str:
    more = [f"and {len(sentences) - most} more"] if len(sentences) > most else []
    return "; ".join([*sentences[:most], *more])


def _shown(moments: Array) -> str:
    return ", ".join(f"{moment:.6g}" for moment in moments)
