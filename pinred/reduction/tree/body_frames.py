"""Body frames in which the sweep is cheap: Denavit–Hartenberg's, for a tree.

Every shape joint turns about or slides along the z axis of its body's frame, and the
step from the parent is Rz(β) Rx(α) after a shift r.  Frames may still turn about their
joint axis and slide along it; that freedom makes β zero for the heaviest child of each
joint (its parent's angle takes it over) and removes a component of r.  Constants
that are zero or one up to round-off are made exactly so, and arithmetic on them folds away.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...common.memo import once
from ...system.joints import axes_of, is_prismatic
from ...system.system import System
from ...system.variants import nominal
from .scalars import Scalar, Sym, Vec

_SNAP = 4e-16  # relative: what is round-off of a rotation's entries
_TURNED = 4e-15  # rad: what is round-off of an angle of a product of rotations


@dataclass(frozen=True)
class Body:
    """One body in its frame.

    parent: index of the parent body, −1 for the root.  prismatic: kind of its joint.
    alpha, beta, r: cosine and sine of the angles of Rz(β) Rx(α), and shift r (3,), from the
    parent's frame at joint value zero.  delta: of a turn Ry(δ) that comes after these where a
    placement is not that of the frames.  offset: angle added to the joint's.  mass, moment,
    inertia: mass, mass times centre of mass (3,), and inertia about the origin in this frame.
    armature: added to the joint's inertia.  frame: this frame in Pinocchio's joint frame.
    """

    parent: int
    prismatic: bool
    alpha: tuple[Scalar, Scalar]
    beta: tuple[Scalar, Scalar]
    r: Vec
    offset: Scalar
    mass: Scalar
    moment: Vec
    inertia: Sym
    armature: Scalar
    frame: pin.SE3
    delta: tuple[Scalar, Scalar] = (1.0, 0.0)


def bodies_of(system: System) -> list[Body]:
    """Return the bodies of a system, root first, shape joints in order.

    One that was given other inertias or placements keeps the frames it had.
    """
    own = nominal(system)
    bodies = once(own, bodies_of, lambda: tuple(_bodies_of(own)))
    if own is system:
        return list(bodies)
    out = [
        replace(body, **_inertia_in(body.frame, system.model.inertias[i + 1]))
        for i, body in enumerate(bodies)
    ]
    for i in range(1, len(out)):
        place = system.model.jointPlacements[i + 1]
        if place != own.model.jointPlacements[i + 1]:
            parent = bodies[out[i].parent]
            step = step_at(parent, bodies[i], own.model.jointPlacements[i + 1], place)
            out[i] = replace(out[i], **step)
    return out


def step_at(parent: Body, body: Body, own: pin.SE3, place: pin.SE3) -> dict[str, Any]:
    """Return what of a body, in its frame, another placement than its own changes.

    R = Rz(β) Rx(α) Ry(δ) Rz(ε), with the β that it has: regular for |δ| < π/2.
    """
    moved = parent.frame.rotation.T @ (place.translation - own.translation)
    carried = body.frame.translation
    if not np.array_equal(place.rotation, own.rotation):
        moved += parent.frame.rotation.T @ ((place.rotation - own.rotation) @ carried)
    size = float(np.linalg.norm(place.translation) + np.linalg.norm(carried))
    r = _snap(np.array(body.r, dtype=float) + moved, size)
    out: dict[str, Any] = {"r": [float(c) for c in r]}
    if np.array_equal(place.rotation, own.rotation):
        return out
    turned = parent.frame.rotation.T @ place.rotation @ body.frame.rotation
    c, s = body.beta
    R = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ turned
    alpha = _near_quarter(float(np.arctan2(-R[1, 2], R[2, 2])))
    delta = _near_quarter(float(np.arcsin(np.clip(R[0, 2], -1.0, 1.0))))
    epsilon = float(np.arctan2(-R[0, 1], R[0, 0]))
    near = epsilon - float(body.offset)
    if abs(near) <= _TURNED:
        epsilon = float(body.offset)
    return out | {
        "alpha": (cosine(alpha), sine(alpha)),
        "delta": (cosine(delta), sine(delta)),
        "offset": epsilon,
    }


def _bodies_of(system: System) -> list[Body]:
    model = system.model
    count = model.njoints - 1
    parents = [model.parents[i + 1] - 1 for i in range(count)]
    heavy = _heaviest_children(parents)
    frames: list[pin.SE3] = [_root_frame(system, axes_of(model.joints[1]))]
    steps: list[tuple[float, float, Array]] = [(0.0, 0.0, np.zeros(3))]
    offsets = [0.0] * count
    order = sorted(range(1, count), key=lambda i: (parents[i], heavy[parents[i]] != i))
    placed = {0: frames[0]}
    kinds = [False] + [is_prismatic(model.joints[i + 1]) for i in range(1, count)]
    made: dict[int, tuple[float, float, Array]] = {}
    for i in order:
        p = parents[i]
        S = axes_of(model.joints[i + 1]).ravel()
        axis = S[:3] if kinds[i] else S[3:]
        turn = p > 0 and heavy[p] == i and not kinds[p]
        if turn:
            beta = _beta(placed[p], model.jointPlacements[i + 1], axis)
            offsets[p] = beta
            placed[p] = placed[p] * pin.SE3(_rz(beta), np.zeros(3))
        made[i], placed[i] = _place(placed[p], model.jointPlacements[i + 1], axis)
    steps += [made[i] for i in range(1, count)]
    bodies = []
    for i in range(count):
        alpha, beta, r = steps[i]
        rotor = model.armature[system.r + i - 1] if i else 0.0
        bodies.append(
            Body(
                parent=parents[i],
                prismatic=kinds[i],
                alpha=(cosine(alpha), sine(alpha)),
                beta=(cosine(beta), sine(beta)),
                r=[float(c) for c in r],
                offset=offsets[i],
                **_inertia_in(placed[i], model.inertias[i + 1]),
                armature=float(rotor),
                frame=placed[i],
            )
        )
    return bodies


def _inertia_in(frame: pin.SE3, inertia: pin.Inertia) -> dict[str, Any]:
    """Return mass, moment and inertia of a body about the origin of a frame, in its axes."""
    Y = frame.actInv(inertia)
    moment = _snap(Y.mass * Y.lever, Y.mass)
    about = Y.inertia + Y.mass * (Y.lever @ Y.lever * np.eye(3) - np.outer(Y.lever, Y.lever))
    about = _snap(about, float(np.abs(about).max()))
    return {
        "mass": float(Y.mass),
        "moment": [float(c) for c in moment],
        "inertia": [float(about[j, k]) for j in range(3) for k in range(j, 3)],
    }


def _heaviest_children(parents: list[int]) -> dict[int, int]:
    """Return for each body the child with the most bodies behind it."""
    size = [1] * len(parents)
    for i in range(len(parents) - 1, 0, -1):
        size[parents[i]] += size[i]
    heavy: dict[int, int] = dict.fromkeys(range(len(parents)), -1)
    for i in range(1, len(parents)):
        best = heavy[parents[i]]
        if best < 0 or size[i] > size[best]:
            heavy[parents[i]] = i
    return heavy


def _root_frame(system: System, S: Array) -> pin.SE3:
    """Return the root body's frame: its joint's own, where there is one axis with that along z."""
    if system.r == 1:
        axis = S.ravel()[3:] if system.group.turns else S.ravel()[:3]
        return pin.SE3(_to_z(axis), np.zeros(3))
    return pin.SE3.Identity()


def _beta(parent: pin.SE3, placement: pin.SE3, axis: Array) -> float:
    """Return the turn about the parent's z that puts a child's axis, or origin, in its xz plane."""
    step = parent.actInv(placement)
    z = step.rotation @ axis
    if np.hypot(z[0], z[1]) > 1e-12:
        return float(np.arctan2(z[0], -z[1]))
    if np.hypot(step.translation[0], step.translation[1]) > 0.0:
        return float(np.arctan2(step.translation[1], step.translation[0]))
    return 0.0


def _place(
    parent: pin.SE3, placement: pin.SE3, axis: Array
) -> tuple[tuple[float, float, Array], pin.SE3]:
    """Return (α, β, r) from the parent's frame, and the child's frame in its joint frame."""
    step = parent.actInv(placement)
    z = step.rotation @ axis
    across = float(np.hypot(z[0], z[1]))
    alpha = _snap_angle(float(np.arctan2(across, z[2])))
    beta = _snap_angle(float(np.arctan2(z[0], -z[1]))) if across > 1e-12 else 0.0
    turn = _rz(beta) @ _rx(alpha)
    k = int(np.argmax(np.abs(z)))
    slide = -step.translation[k] / z[k]
    r = step.translation + slide * z
    r[k] = 0.0
    frame = step.inverse() * pin.SE3(turn, r)
    return (alpha, beta, _snap(r, float(np.linalg.norm(step.translation)))), frame


def _to_z(axis: Array) -> Array:
    """Return a rotation that takes e_z to the axis."""
    x, y, z = axis
    across = np.hypot(x, y)
    beta = np.arctan2(x, -y) if across > 0 else 0.0
    return _rz(float(beta)) @ _rx(float(np.arctan2(across, z)))


def _rz(angle: float) -> Array:
    c, s = cosine(angle), sine(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _rx(angle: float) -> Array:
    c, s = cosine(angle), sine(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def cosine(angle: float) -> float:
    """Return cos, exactly 0 or ±1 at quarter turns."""
    return _snap_unit(float(np.cos(angle)))


def sine(angle: float) -> float:
    """Return sin, exactly 0 or ±1 at quarter turns."""
    return _snap_unit(float(np.sin(angle)))


def _snap_unit(value: float) -> float:
    nearest = round(value)
    return float(nearest) if abs(value - nearest) <= _SNAP else value


def _snap_angle(angle: float) -> float:
    quarters = round(angle / (np.pi / 2))
    return quarters * np.pi / 2 if abs(angle - quarters * np.pi / 2) <= 4 * _SNAP else angle


def _near_quarter(angle: float) -> float:
    """Return a quarter turn where an angle of a product of rotations is one."""
    quarters = round(angle / (np.pi / 2))
    return quarters * np.pi / 2 if abs(angle - quarters * np.pi / 2) <= _TURNED else angle


def _snap(values: Array, scale: float) -> Array:
    return np.where(np.abs(values) <= 8 * _SNAP * scale, 0.0, values)
