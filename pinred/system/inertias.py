"""Conditions on the inertias of a model, and the words for those that are not met.

Refused is what has no meaning (numbers that are not finite, negative masses and moments) and
what makes the mass matrix singular at every shape.  What only no real body can have, or makes
the matrix singular at single shapes, is told as a doubt.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..common.arrays import Array
from ..common.errors import ModelError
from ..common.plain_names import listed, quoted
from .coupling import Coupled
from .joints import axes_of, is_prismatic
from .massless_motions import largest_step, no_moment
from .singular_mass_matrix import SingularShape, singular_shapes

TRIANGLE_SLACK = 1e-9  # a flat body meets the triangle inequality with equality, up to round-off

_HUGE = 1e100  # kg, kg m², m


def check_inertias(model: pin.Model, coupled: Coupled | None = None) -> tuple[str, ...]:
    """Return what is doubtful about the inertias of a model, each as a sentence.

    coupled: how its joints follow each other, if some do.
    Raises ModelError, naming links or joints and the way out, for what cannot be simulated.
    """
    unit = largest_step(model)
    for i in range(1, model.njoints):
        _check_body(model, i, unit)
    if not sum(model.inertias[i].mass for i in range(1, model.njoints)) > 0.0:
        raise ModelError(f"{body_of(model, 1)} has no mass, nor has anything that hangs on it")
    singular = singular_shapes(model, coupled)
    if singular.everywhere:
        raise ModelError(_refusal(model, singular.everywhere))
    doubts = (
        _triangle(model, unit),
        _nearly(model, singular.nearly),
        _isolated(model, singular.isolated),
    )
    return tuple(doubt for doubt in doubts if doubt)


def body_of(model: pin.Model, i: int) -> str:
    """Return words for the body that joint i moves: its links and the joint."""
    links = [f.name for f in model.frames if f.parentJoint == i and f.type == pin.FrameType.BODY]
    who = f"link {quoted(links[0])}" if links else "the body"
    if len(links) > 1:
        who += f" (with {listed(links[1:], 3)})"
    return f"{who} moved by joint {quoted(model.names[i])}"


def _check_body(model: pin.Model, i: int, unit: float) -> None:
    body = model.inertias[i]
    mass, inertia = body.mass, body.inertia
    if not all(np.isfinite(a).all() for a in (mass, inertia, body.lever)):
        raise ModelError(f"{body_of(model, i)} has an inertia that is not finite")
    largest = max(mass, float(np.abs(inertia).max()), float(np.abs(body.lever).max()))
    if largest > _HUGE:
        raise ModelError(
            f"{body_of(model, i)} has a mass, a moment of inertia or a lever of {largest:.1e}, "
            f"above {_HUGE:g}, of which products overflow; take other units"
        )
    if mass < 0.0:
        raise ModelError(
            f"{body_of(model, i)} has negative mass {mass:g}; give it a positive one, or none"
        )
    moments = np.linalg.eigvalsh(inertia)
    if moments[0] < -no_moment(body, unit):
        raise ModelError(
            f"{body_of(model, i)} has principal moments of inertia {_shown(moments)}; "
            "none may be negative"
        )


def _refusal(model: pin.Model, joints: tuple[str, ...]) -> str:
    """Return why a model is refused whose joints move no mass at any shape."""
    i = model.getJointId(joints[0])
    body, behind = model.inertias[i], len(model.children[i]) > 0
    lacks = "no mass"
    if body.mass > 0.0:
        moments = np.linalg.eigvalsh(body.inertia)
        in_point = moments[2] <= no_moment(body, largest_step(model))
        lacks = f"its mass in one {'point' if in_point else 'line'}"
        if not in_point:
            lacks += f" (principal moments of inertia {_shown(moments)})"
    text = f"{body_of(model, i)} has {lacks}"
    if behind:
        text += ", and what hangs behind it can undo the joint's motion"
    text += ": at no shape does the joint move any mass, so the mass matrix is singular; "
    text += "give it a mass" if body.mass == 0.0 else "give it moments of inertia"
    if i > 1:
        return f"{text}, give the joint armature, or lock it: lock={list(joints)}"
    return f"{text}, or choose a smaller group"


def _triangle(model: pin.Model, unit: float) -> str:
    """Return which bodies break the triangle inequality of moments of inertia, and by how much."""
    broken = []
    for i in range(1, model.njoints):
        body = model.inertias[i]
        moments = np.linalg.eigvalsh(body.inertia)
        others = float(moments[0] + moments[1])
        if moments[2] > others * (1.0 + TRIANGLE_SLACK) + no_moment(body, unit):
            much = f"{100.0 * (moments[2] / others - 1.0):.3g} %" if others > 0.0 else "all of it"
            broken.append(f"{body_of(model, i)} by {much} ({_shown(moments)})")
    if not broken:
        return ""
    return (
        "no distribution of mass has these principal moments of inertia, the largest above the "
        f"sum of the others (triangle inequality): {_some(broken)}"
    )


def _nearly(model: pin.Model, joints: tuple[str, ...]) -> str:
    if not joints:
        return ""
    body = body_of(model, model.getJointId(joints[0]))
    return (
        f"the mass matrix is nearly singular at every shape: joint {listed(joints)} moves hardly "
        f"any mass ({body}); lock={list(joints)} removes what moves none"
    )


def _isolated(model: pin.Model, shapes: tuple[SingularShape, ...]) -> str:
    """Return at which single shapes joints move no mass."""
    if not shapes:
        return ""
    where: dict[tuple[str, str], list[str]] = {}  # of one joint's values, in a row
    for shape in shapes:
        *others, last = [_valued(model, *entry) for entry in shape.at.items()]
        name, _, value = last.rpartition(" = ")
        where.setdefault((shape.joint, ", ".join([*others, name])), []).append(value)
    told = [
        f"joint {quoted(joint)} moves no mass at {names} = {' or '.join(values)}"
        for (joint, names), values in where.items()
    ]
    return (
        "the mass matrix is singular at single shapes, where a simulation cannot go on: "
        f"{_some(told)}"
    )


def _valued(model: pin.Model, name: str, value: float) -> str:
    unit = "m" if is_prismatic(model.joints[model.getJointId(name)]) else "rad"
    return f"{quoted(name)} = {value:.6g} {unit}"


def _some(parts: list[str], most: int = 6) -> str:
    more = [f"and {len(parts) - most} more"] if len(parts) > most else []
    return "; ".join([*parts[:most], *more])


def _shown(moments: np.ndarray) -> str:
    return ", ".join(f"{moment:.6g}" for moment in moments)


def moved_masses(model: pin.Model, data: pin.Data, q: Array) -> tuple[NDArray[np.bool_], Array]:
    """Return which velocities turn, (nv,), and the mass that each moves, (nv,) [kg]."""
    pin.crba(model, data, q)
    angular, mass = np.ones(model.nv, dtype=bool), np.empty(model.nv)
    for i in range(1, model.njoints):
        joint = model.joints[i]
        own = slice(joint.idx_v, joint.idx_v + joint.nv)
        angular[own] = np.abs(axes_of(joint)[3:]).sum(axis=0) > 0.0
        mass[own] = data.Ycrb[i].mass
    return angular, mass


def radius_of_gyration(body: pin.Inertia) -> float:
    """Return √(tr I / m) of a body about its centre of mass [m]; 0 of one without mass."""
    if not body.mass > 0.0:
        return 0.0
    return float(np.sqrt(max(0.0, np.trace(body.inertia)) / body.mass))
