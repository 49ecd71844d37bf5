"""Articulated inertias, and the transformations ("steps") between body frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from .body_frames import Body, Freedom
from .scalars import INDEX, Mat, Rotation, Scalar, Sym, Turn, Vec, add, cross, mul, plus, total


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
