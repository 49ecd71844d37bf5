"""Body frames that minimise the operations of the sweep: Denavit–Hartenberg frames of a tree.

Every hinge rotates about, and every slide moves along, the z axis of its body's frame.  The step
from the parent is Rz(β) Rx(α) after a shift r.  A frame may still be rotated about its joint axis
and moved along it.  This freedom makes β zero for the heaviest child of each joint, because the
parent's joint angle absorbs β, and removes one component of r.  Constants that are 0 or ±1 up to
round-off are set exactly, so that arithmetic with them is simplified.

The frame of a ball's body has the axes of its parent's frame when the ball is at rest, so that the
step has no constant rotation.

A `Step` is the transformation from the frame of the parent; it moves momenta, twists and inertias.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...common.memo import once
from ...system.joints import BALL, HINGE, SLIDE, ElementaryJoint, axes_of
from ...system.system import System, nominal
from .scalars import INDEX, Mat, Rotation, Scalar, Sym, Turn, Vec, add, cross, dot, mul, plus, total

_SNAP = 4e-16  # round-off of the entries of a rotation matrix
_ANGLE = 4e-15  # round-off of an angle computed from a product of rotations [rad]


@dataclass(frozen=True)
class Freedom:
    """One rate of a joint: a translation along, or rotation about, an axis of the body's frame.

    Attributes:
        slides: Whether it is a translation.
        axis: Index of the axis.
        armature: Rotor inertia that is added to the rate [kg m² | kg].
    """

    slides: bool
    axis: int
    armature: Scalar

    def along(self, lin: Vec, ang: Vec) -> Scalar:
        """Return the component of a momentum, twist or wrench that belongs to the rate."""
        return (lin if self.slides else ang)[self.axis]


@dataclass(frozen=True)
class Body:
    """Constants of one body, expressed in its body frame of the sweep.

    Attributes:
        parent: Index of the parent body, −1 for the root.
        kind: Kind of its joint; the root counts as a hinge.
        x_at: Index of its first coordinate among the coordinates of all joints; −1 for the root.
        v_at: Index of its first rate among the rates of all joints; −1 for the root.
        alpha: Cosine and sine of the angle of Rx(α), from the parent's frame at joint value zero.
        beta: Cosine and sine of the angle of Rz(β), which is applied first.
        r: Shift from the parent's origin, (3,) [m].
        offset: Angle that is added to the joint angle [rad].
        mass: Mass [kg].
        moment: Mass times centre of mass, (3,) [kg m].
        inertia: Inertia about the frame's origin [kg m²].
        armature: Rotor inertia that is added to the joint [kg m² | kg].
        frame: Placement of this body frame in Pinocchio's joint frame.
        delta: Cosine and sine of a further rotation Ry(δ) after Rx(α), if the joint's placement
            was changed after loading.
    """

    parent: int
    kind: ElementaryJoint
    x_at: int
    v_at: int
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

    @property
    def prismatic(self) -> bool:
        """Whether its joint is a slide."""
        return self.kind is SLIDE

    @property
    def is_ball(self) -> bool:
        """Whether its joint is a ball."""
        return self.kind is BALL

    @property
    def freedoms(self) -> tuple[Freedom, ...]:
        """The rates of its joint; a ball rotates about all three axes."""
        axes = (0, 1, 2) if self.is_ball else (2,)
        return tuple(Freedom(self.prismatic, axis, self.armature) for axis in axes)

    def to_frame(self, v: Sequence[Scalar]) -> Vec:
        """Rotate a vector (3,) from Pinocchio's joint frame to this body frame."""
        return [dot([float(c) for c in row], list(v)) for row in self.frame.rotation.T]

    def to_joint(self, v: Sequence[Scalar]) -> Vec:
        """Rotate a vector (3,) from this body frame to Pinocchio's joint frame."""
        return [dot([float(c) for c in row], list(v)) for row in self.frame.rotation]


def bodies_of(system: System) -> list[Body]:
    """Return the bodies of a system, root first, shape joints in order.

    A variant with other inertias or placements has the frames of the nominal system.
    """
    original = nominal(system)
    bodies = once(original, bodies_of, lambda: tuple(_make_bodies(original)))
    if original is system:
        return list(bodies)
    changed = [
        replace(body, **_inertia_in(body.frame, system.sorted_model.inertias[i + 1]))
        for i, body in enumerate(bodies)
    ]
    for i in range(1, len(changed)):
        place, old = (s.model.jointPlacements[i + 1] for s in (system, original))
        if place != old:
            step = step_at(bodies[changed[i].parent], bodies[i], old, place)
            changed[i] = replace(changed[i], **step)
    return changed


def with_rotors(bodies: list[Body], rotors: Sequence[int]) -> list[Body]:
    """Return the bodies with exactly equal moments and no first moment for spherical rotors.

    Args:
        bodies: Bodies of the tree, root first.
        rotors: Indices of the spherical rotors among the bodies.
    Returns:
        The bodies; those of the rotors lose the round-off of their inertia.
    """
    bodies = list(bodies)
    for i in rotors:
        moment = bodies[i].inertia[0]
        inertia = [moment, 0.0, 0.0, moment, 0.0, moment]
        bodies[i] = replace(bodies[i], moment=[0.0, 0.0, 0.0], inertia=inertia)
    return bodies


def step_at(parent: Body, body: Body, old: pin.SE3, place: pin.SE3) -> dict[str, Any]:
    """Compute the step of a body after its joint's placement has changed.

    R = Rz(β) Rx(α) Ry(δ) Rz(ε) at the present β is regular for |δ| < π/2.

    Args:
        parent: Parent body.
        body: The body with its old placement.
        old: Placement of the body's joint before the change.
        place: Placement of the body's joint after the change.
    Returns:
        The fields of the body that change.
    """
    shift = parent.frame.rotation.T @ (place.translation - old.translation)
    origin = body.frame.translation
    if not np.array_equal(place.rotation, old.rotation):
        shift += parent.frame.rotation.T @ ((place.rotation - old.rotation) @ origin)
    size = float(np.linalg.norm(place.translation) + np.linalg.norm(origin))
    r = _snap(np.array(body.r, dtype=float) + shift, size)
    step: dict[str, Any] = {"r": [float(c) for c in r]}
    if np.array_equal(place.rotation, old.rotation):
        return step
    rotation = parent.frame.rotation.T @ place.rotation @ body.frame.rotation
    c, s = body.beta
    R = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ rotation
    alpha = _snap_angle(float(np.arctan2(-R[1, 2], R[2, 2])), _ANGLE)
    delta = _snap_angle(float(np.arcsin(np.clip(R[0, 2], -1.0, 1.0))), _ANGLE)
    epsilon = float(np.arctan2(-R[0, 1], R[0, 0]))
    if abs(epsilon - float(body.offset)) <= _ANGLE:
        epsilon = float(body.offset)
    return step | {
        "alpha": (cosine(alpha), sine(alpha)),
        "delta": (cosine(delta), sine(delta)),
        "offset": epsilon,
    }


def _make_bodies(system: System) -> list[Body]:
    """Choose the body frames, and return the bodies expressed in these frames."""
    model = system.sorted_model
    count = model.njoints - 1
    parents = [model.parents[i + 1] - 1 for i in range(count)]
    heavy = _heaviest_children(parents)
    steps: dict[int, tuple[float, float, Array]] = {0: (0.0, 0.0, np.zeros(3))}
    offsets = [0.0] * count
    order = sorted(range(1, count), key=lambda i: (parents[i], heavy[parents[i]] != i))
    frames = {0: _root_frame(system, axes_of(model.joints[1]))}
    kinds = [HINGE, *(joint.kind for joint in system.tree.joints)]
    for i in order:
        p = parents[i]
        if kinds[i] is BALL:
            steps[i], frames[i] = _place_ball(frames[p], model.jointPlacements[i + 1])
            continue
        S = axes_of(model.joints[i + 1]).ravel()
        axis = S[:3] if kinds[i] is SLIDE else S[3:]
        if p > 0 and heavy[p] == i and kinds[p] is HINGE:
            beta = _beta(frames[p], model.jointPlacements[i + 1], axis)
            offsets[p] = beta
            frames[p] = frames[p] * pin.SE3(_rz(beta), np.zeros(3))
        steps[i], frames[i] = _place(frames[p], model.jointPlacements[i + 1], axis)
    bodies = []
    for i in range(count):
        alpha, beta, r = steps[i]
        placed = system.tree.joints[i - 1] if i else None
        rotor = model.armature[system.r + placed.v.start] if placed else 0.0
        bodies.append(
            Body(
                parent=parents[i],
                kind=kinds[i],
                x_at=placed.x.start if placed else -1,
                v_at=placed.v.start if placed else -1,
                alpha=(cosine(alpha), sine(alpha)),
                beta=(cosine(beta), sine(beta)),
                r=[float(c) for c in r],
                offset=offsets[i],
                **_inertia_in(frames[i], model.inertias[i + 1]),
                armature=float(rotor),
                frame=frames[i],
            )
        )
    return bodies


def _inertia_in(frame: pin.SE3, inertia: pin.Inertia) -> dict[str, Any]:
    """Return a body's mass, first moment and inertia in a frame, about its origin."""
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
    """Return, for each body, the child with the most bodies in its subtree."""
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
    """Return the root body's frame, with z along the joint axis if there is only one."""
    if system.r == 1:
        axis = S.ravel()[3:] if system.group.turns else S.ravel()[:3]
        return pin.SE3(_to_z(axis), np.zeros(3))
    return pin.SE3.Identity()


def _beta(parent: pin.SE3, placement: pin.SE3, axis: Array) -> float:
    """Return the angle about the parent's z to the plane of the child's axis, or its origin."""
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
    """Return the step (α, β, r) to a child, and the child's frame in its joint frame.

    parent: frame of the parent in its joint frame.  placement, axis: placement and axis of the
    child's joint.
    """
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


def _place_ball(parent: pin.SE3, placement: pin.SE3) -> tuple[tuple[float, float, Array], pin.SE3]:
    """Return the step (α, β, r) to the body of a ball, and its frame in its joint frame.

    parent: frame of the parent in its joint frame.  placement: placement of the ball.
    """
    step = parent.actInv(placement)
    inverse = np.vectorize(_snap_unit)(step.rotation.T)
    r = _snap(step.translation, float(np.linalg.norm(step.translation)))
    return (0.0, 0.0, r), pin.SE3(inverse, np.zeros(3))


def _to_z(axis: Array) -> Array:
    """Return a rotation that maps e_z to the axis."""
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
    """Return the cosine, exactly 0 or ±1 at quarter turns."""
    return _snap_unit(float(np.cos(angle)))


def sine(angle: float) -> float:
    """Return the sine, exactly 0 or ±1 at quarter turns."""
    return _snap_unit(float(np.sin(angle)))


def _snap_unit(value: float) -> float:
    nearest = round(value)
    return float(nearest) if abs(value - nearest) <= _SNAP else float(value)


def _snap_angle(angle: float, tolerance: float = 4 * _SNAP) -> float:
    """Round an angle to the nearest quarter turn if they differ by less than the tolerance."""
    quarter = round(angle / (np.pi / 2)) * np.pi / 2
    return quarter if abs(angle - quarter) <= tolerance else angle


def _snap(values: Array, scale: float) -> Array:
    return np.where(np.abs(values) <= 8 * _SNAP * scale, 0.0, values)


@dataclass
class Articulated:
    """Momentum of a subtree as a function of the twist (v, ω) of its root body.

    The momentum is (M v + Bᵀ ω + lin, B v + I ω + ang).

    Attributes:
        M: Linear momentum per linear velocity, symmetric (3, 3).
        B: Angular momentum per linear velocity.
        I: Angular momentum per angular velocity, symmetric.
        lin: Constant linear momentum, (3,).
        ang: Constant angular momentum, (3,).
    """

    M: Sym
    B: Mat
    I: Sym
    lin: Vec
    ang: Vec


@dataclass
class Step:
    """The transformation from a parent's frame to a body's frame at a joint value.

    Attributes:
        turns: Rotations from the parent's axes to the body's axes, by the angles β, α, δ and θ; for
            a ball, the last one is its rotation.
        shift: Translation r in the parent's axes.
        slide: Translation of a prismatic joint along the body's z axis.
    """

    turns: Sequence[Turn | Rotation]
    shift: Vec
    slide: Scalar

    @property
    def slides(self) -> bool:
        """Whether the step includes a translation along the body's z axis."""
        return not (isinstance(self.slide, float) and self.slide == 0.0)

    @property
    def fixed(self) -> Step:
        """The constant factor of the step, which precedes the motion of the joint."""
        return Step(self.turns[:-1], self.shift, 0.0)

    @property
    def moving(self) -> Step:
        """The factor of the step that the joint moves; it follows the constant factor."""
        return Step(self.turns[-1:], [0.0, 0.0, 0.0], self.slide)

    def inward(self, lin: Vec, ang: Vec) -> tuple[Vec, Vec]:
        """Transform a momentum from the body's frame and origin to the parent's."""
        if self.slides:
            ang = plus(ang, cross([0.0, 0.0, self.slide], lin))
        for turn in reversed(self.turns):
            if not turn.is_none:
                lin, ang = turn.vector(lin), turn.vector(ang)
        return lin, plus(ang, cross(self.shift, lin))

    def outward(self, v: Vec, w: Vec) -> tuple[Vec, Vec]:
        """Transform a twist from the parent's frame and origin to the body's."""
        v = plus(v, cross(w, self.shift))
        for turn in self.turns:
            if not turn.is_none:
                v, w = turn.back(v), turn.back(w)
        if self.slides:
            v = plus(v, cross(w, [0.0, 0.0, self.slide]))
        return v, w


def rigid(body: Body) -> Articulated:
    """Return the inertia of one rigid body, with zero constant momentum."""
    x, y, z = body.moment
    m = body.mass
    return Articulated(
        M=[m, 0.0, 0.0, m, 0.0, m],
        B=[[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]],
        I=list(body.inertia),
        lin=[0.0, 0.0, 0.0],
        ang=[0.0, 0.0, 0.0],
    )


def carried(a: Articulated, step: Step) -> Articulated:
    """Transform the inertia of a subtree from the body's frame to the parent's frame."""
    M, B, I = a.M, a.B, a.I
    if step.slides:
        B, I = shifted(M, B, I, [0.0, 0.0, step.slide])
    for turn in reversed(step.turns):
        if not turn.is_none:
            M, B, I = turn.symmetric(M), turn.matrix(B), turn.symmetric(I)
    B, I = shifted(M, B, I, step.shift)
    return Articulated(M, B, I, *step.inward(a.lin, a.ang))


def shifted(M: Sym, B: Mat, I: Sym, r: Vec) -> tuple[Mat, Sym]:
    """Shift the reference point of an inertia by −r: B′ = B + r̂M, I′ = I − B r̂ + r̂ B′ᵀ.

    Args:
        M: Linear momentum per linear velocity.
        B: Angular momentum per linear velocity.
        I: Angular momentum per angular velocity.
        r: Position of the old reference point relative to the new point, (3,).
    Returns:
        B′ and I′ about the new reference point.
    """
    if all(isinstance(c, float) and c == 0.0 for c in r):
        return B, I
    columns = [cross(r, [M[INDEX[k][j]] for k in range(3)]) for j in range(3)]
    new_B = [[add(B[i][j], columns[j][i]) for j in range(3)] for i in range(3)]
    products = [cross(r, B[i]) for i in range(3)]  # row i of −B r̂
    right = [cross(r, new_B[j]) for j in range(3)]  # column j of r̂ B′ᵀ
    new_I = list(I)
    for i in range(3):
        for j in range(i, 3):
            new_I[INDEX[i][j]] = add(I[INDEX[i][j]], add(products[i][j], right[j][i]))
    return new_B, new_I


def linear_row(a: Articulated, k: int, v: Vec, w: Vec) -> Scalar:
    """Return entry k of the linear momentum at twist (v, w)."""
    row = [mul(a.M[INDEX[k][j]], v[j]) for j in range(3)] + [mul(a.B[j][k], w[j]) for j in range(3)]
    return add(a.lin[k], total(row))


def angular_row(a: Articulated, k: int, v: Vec, w: Vec) -> Scalar:
    """Return entry k of the angular momentum at twist (v, w)."""
    row = [mul(a.B[k][j], v[j]) for j in range(3)] + [mul(a.I[INDEX[k][j]], w[j]) for j in range(3)]
    return add(a.ang[k], total(row))


def moved_twist(body: Body, v: Vec, w: Vec, rates: Sequence[Scalar]) -> tuple[Vec, Vec]:
    """Add the motion of a body's joint to its twist (v, w); rates: rates of all tree joints."""
    if body.is_ball:
        return v, plus(w, body.to_frame(rates[body.v_at : body.v_at + 3]))
    v, w = list(v), list(w)
    changed = v if body.prismatic else w
    changed[2] = add(changed[2], rates[body.v_at])
    return v, w


def momentum_of_rate(freedom: Freedom, a: Articulated) -> tuple[Vec, Vec]:
    """Return the linear and angular momentum of a subtree per unit rate of its joint."""
    axis = freedom.axis
    if freedom.slides:
        return [a.M[INDEX[k][axis]] for k in range(3)], [a.B[k][axis] for k in range(3)]
    return [a.B[axis][k] for k in range(3)], [a.I[INDEX[k][axis]] for k in range(3)]
