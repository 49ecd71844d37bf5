"""Articulated inertias and the steps between bodies: what the sweep carries from joint to joint."""

from __future__ import annotations

from dataclasses import dataclass

from .body_frames import Body
from .scalars import INDEX, Mat, Scalar, Sym, Turn, Vec, add, cross, mul, plus, total


@dataclass
class Articulated:
    """Momentum of a subtree from the twist (v, ω) of its root body.

    It is (M v + Bᵀ ω + lin, B v + I ω + ang).  M: linear from linear.  B: angular from
    linear.  I: angular from angular.
    """

    M: Sym
    B: Mat
    I: Sym
    lin: Vec
    ang: Vec


@dataclass
class Step:
    """The way from a parent's frame to a body's, at a joint value."""

    turns: list[Turn]  # from the parent's axes to the body's: β, α, δ, θ
    shift: Vec  # r in the parent's axes
    slide: Scalar  # along the body's z, of a prismatic joint

    @property
    def slides(self) -> bool:
        """Whether there is a shift along the body's z."""
        return not (isinstance(self.slide, float) and self.slide == 0.0)

    @property
    def fixed(self) -> Step:
        """The part that the joint does not move; the moving part comes after it."""
        return Step(self.turns[:-1], self.shift, 0.0)

    @property
    def moving(self) -> Step:
        """The part about or along the joint's axis."""
        return Step(self.turns[-1:], [0.0, 0.0, 0.0], self.slide)

    def inward(self, lin: Vec, ang: Vec) -> tuple[Vec, Vec]:
        """Return a momentum at the body's origin, taken at the parent's, in its axes."""
        if self.slides:
            ang = plus(ang, cross([0.0, 0.0, self.slide], lin))
        for turn in reversed(self.turns):
            if not turn.is_none:
                lin, ang = turn.vector(lin), turn.vector(ang)
        return lin, plus(ang, cross(self.shift, lin))

    def outward(self, v: Vec, w: Vec) -> tuple[Vec, Vec]:
        """Return the parent's twist at the body's origin, in the body's axes."""
        v = plus(v, cross(w, self.shift))
        for turn in self.turns:
            if not turn.is_none:
                v, w = turn.back(v), turn.back(w)
        if self.slides:
            v = plus(v, cross(w, [0.0, 0.0, self.slide]))
        return v, w


def rigid(body: Body) -> Articulated:
    """Return the inertia of one body, with no momentum of its own."""
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
    """Return a subtree turned into the axes before a step and shifted to the origin there."""
    M, B, I = a.M, a.B, a.I
    if step.slides:
        B, I = shifted(M, B, I, [0.0, 0.0, step.slide])
    for turn in reversed(step.turns):
        if not turn.is_none:
            M, B, I = turn.symmetric(M), turn.matrix(B), turn.symmetric(I)
    B, I = shifted(M, B, I, step.shift)
    return Articulated(M, B, I, *step.inward(a.lin, a.ang))


def shifted(M: Sym, B: Mat, I: Sym, r: Vec) -> tuple[Mat, Sym]:
    """Return B′ = B + r̂M and I − B r̂ + r̂ B′ᵀ: taken about a point at −r."""
    if all(isinstance(c, float) and c == 0.0 for c in r):
        return B, I
    columns = [cross(r, [M[INDEX[k][j]] for k in range(3)]) for j in range(3)]
    moved = [[add(B[i][j], columns[j][i]) for j in range(3)] for i in range(3)]
    left = [cross(r, B[i]) for i in range(3)]  # row i of −B r̂
    right = [cross(r, moved[j]) for j in range(3)]  # column j of r̂ B′ᵀ
    shifted = list(I)
    for i in range(3):
        for j in range(i, 3):
            shifted[INDEX[i][j]] = add(I[INDEX[i][j]], add(left[i][j], right[j][i]))
    return moved, shifted


def linear_row(a: Articulated, k: int, v: Vec, w: Vec) -> Scalar:
    """Return entry k of the linear momentum at twist (v, w)."""
    row = [mul(a.M[INDEX[k][j]], v[j]) for j in range(3)] + [mul(a.B[j][k], w[j]) for j in range(3)]
    return add(a.lin[k], total(row))


def angular_row(a: Articulated, k: int, v: Vec, w: Vec) -> Scalar:
    """Return entry k of the angular momentum at twist (v, w)."""
    row = [mul(a.B[k][j], v[j]) for j in range(3)] + [mul(a.I[INDEX[k][j]], w[j]) for j in range(3)]
    return add(a.ang[k], total(row))


def momentum_of_rate(body: Body, a: Articulated) -> tuple[Vec, Vec]:
    """Return the momentum of a subtree, linear and angular, per unit rate of its joint."""
    if body.prismatic:
        return [a.M[INDEX[k][2]] for k in range(3)], [a.B[k][2] for k in range(3)]
    return [a.B[2][k] for k in range(3)], [a.I[INDEX[k][2]] for k in range(3)]


def along_joint(body: Body, lin: Vec, ang: Vec) -> Scalar:
    """Return the component of a momentum along a joint's axis, in its body's frame."""
    return (lin if body.prismatic else ang)[2]
