"""Body frames in which the sweep is cheap: Denavit–Hartenberg's, for a tree.

Every shape joint turns about or slides along the z axis of its body's frame, and the
step from the parent is Rz(β) Rx(α) after a shift r.  Frames may still turn about their
joint axis and slide along it; that freedom makes β zero for the heaviest child of each
joint (its parent's angle takes it over) and removes a component of r.  Constants
that are zero or one up to round-off are made exactly so, and arithmetic on them folds away.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...system.joints import axes_of, is_prismatic
from ...system.system import System
from .scalars import Scalar, Sym, Vec

_SNAP = 4e-16  # relative: what is round-off of a rotation's entries


@dataclass(frozen=True)
class Body:
    """One body in its frame.

    parent: index of the parent body, −1 for the root.  prismatic: kind of its joint.
    alpha, beta, r: cosine and sine of the angles of Rz(β) Rx(α), and shift r (3,), from the
    parent's frame at joint value zero.  offset: angle added to the joint's.  mass, moment,
    inertia: mass, mass times centre of mass (3,), and inertia about the origin in this frame.
    armature: added to the joint's inertia.  frame: this frame in Pinocchio's joint frame.
    """

    parent: int
    prismatic: bool
    alpha: tuple[Scalar, Scalar]
    beta: tuple[Scalar, Scalar]
    r: Vec
    offset: float
    mass: Scalar
    moment: Vec
    inertia: Sym
    armature: Scalar
    frame: pin.SE3


def bodies_of(system: System) -> list[Body]:
    """Return the bodies of a system, root first, shape joints in order."""
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
        Y = placed[i].actInv(model.inertias[i + 1])
        moment = _snap(Y.mass * Y.lever, Y.mass)
        about = Y.inertia + Y.mass * (Y.lever @ Y.lever * np.eye(3) - np.outer(Y.lever, Y.lever))
        about = _snap(about, float(np.abs(about).max()))
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
                mass=float(Y.mass),
                moment=[float(c) for c in moment],
                inertia=[float(about[j, k]) for j in range(3) for k in range(j, 3)],
                armature=float(rotor),
                frame=placed[i],
            )
        )
    return bodies


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


def _snap(values: Array, scale: float) -> Array:
    return np.where(np.abs(values) <= 8 * _SNAP * scale, 0.0, values)
