"""H(x) [ξ; ẋ] = [μ; π] and π̇, in one sweep over the tree: O(n), no mass matrix.

Inward, each joint is eliminated from the articulated inertia of its subtree, as in
Featherstone's algorithm but without bias forces, for only momenta are wanted.  At the
root a system of the group's size is solved.  The twists follow outward; the momentum of
a subtree is its articulated inertia times the twist it is carried with, so that

    π̇_j = (v_j × S_j) · h_j

needs no second inward sweep, and only two or four entries of h_j.  Source: R.
Featherstone, "Rigid Body Dynamics Algorithms", 2008, ch. 7.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

from .body_frames import Body, cosine, sine
from .limbs import Lanes, Link, links_of
from .scalars import (
    INDEX,
    Mat,
    Scalar,
    Sym,
    Turn,
    Vec,
    add,
    cross,
    dot,
    mul,
    plus,
    solve_ldl,
    sub,
    total,
)


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

    turns: list[Turn]  # from the parent's axes to the body's: β, α, θ
    shift: Vec  # r in the parent's axes
    slide: Scalar  # along the body's z, of a prismatic joint

    @property
    def fixed(self) -> Step:
        """The part that the joint does not move; the moving part comes after it."""
        return Step(self.turns[:2], self.shift, 0.0)

    @property
    def moving(self) -> Step:
        """The part about or along the joint's axis."""
        return Step(self.turns[2:], [0.0, 0.0, 0.0], self.slide)

    def inward(self, lin: Vec, ang: Vec) -> tuple[Vec, Vec]:
        """Return a momentum at the body's origin, taken at the parent's, in its axes."""
        if not isinstance(self.slide, float):
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
        if not isinstance(self.slide, float):
            v = plus(v, cross(w, [0.0, 0.0, self.slide]))
        return v, w


@dataclass
class Eliminated:
    """An eliminated joint, for the outward sweep, in its body's frame at joint value zero."""

    inner: Articulated  # of the subtree with the joint's velocity eliminated
    gain: Vec  # U/D, linear
    gain_angular: Vec  # U/D, angular
    drive: Scalar  # u/D
    step: Step


@dataclass
class Swept:
    """Velocities and rates.  root_linear, root_angular: twist of the root body.

    xdot, pi, pidot: per shape joint; π of a joint whose rate is prescribed is found here.
    """

    root_linear: Vec
    root_angular: Vec
    xdot: list[Scalar]
    pi: list[Scalar]
    pidot: list[Scalar]


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


def sweep(
    bodies: list[Body],
    x: list[Scalar],
    pi: list[Scalar],
    mu: list[Scalar],
    axes: Sequence[int],
    root_armature: float,
    rates: Mapping[int, Scalar],
    lanes: Lanes | None = None,
) -> Swept:
    """Solve H v = p and return velocities and π̇ (without forces).

    x, pi: per shape joint.  mu: (r,).  axes: of the group (see Group).  root_armature: added
    to the diagonal of SO(2)'s locked inertia.  rates: ẋ of the joints that are prescribed,
    whose π is not read.  lanes: if given, limbs of one build are computed at once, and marked
    there.
    """
    links = links_of(bodies, lanes, {k + 1 for k in rates})
    lanes = lanes or Lanes()  # that nothing is marked in
    inertia = [rigid(link.body) for link in links]
    joints: list[Eliminated | None] = [None] * len(links)
    for i in range(len(links) - 1, 0, -1):
        link = links[i]
        step = _packed_step(link, bodies, x, lanes)
        # The step about or along the joint's own axis comes first: the division by D need not
        # wait for it, and outward nothing waits for the rate that it does not move.
        inner = _carried(inertia[i], step.moving)
        if link.lanes[0] - 1 in rates:
            joint = _drive(link.body, inner, lanes.pack([rates[k - 1] for k in link.lanes]), step)
        else:
            momentum = lanes.pack([pi[k - 1] for k in link.lanes])
            joint = _eliminate(link.body, inner, momentum, step)
        joints[i] = joint
        width = len(link.lanes) if len(links[link.parent].lanes) == 1 else 1
        _add(inertia[link.parent], _carried(joint.inner, step.fixed), lanes, width)
    linear, angular = _solve_root(inertia[0], mu, [divmod(k, 3) for k in axes], root_armature)
    v, w = [linear], [angular]
    xdot: list[Scalar] = [0.0] * len(x)
    momenta = list(pi)
    pidot: list[Scalar] = [0.0] * len(x)
    for i in range(1, len(links)):
        link, body, known = links[i], links[i].body, joints[i]
        assert known is not None
        vi, wi = known.step.fixed.outward(v[link.parent], w[link.parent])
        rate = sub(known.drive, add(dot(known.gain, vi), dot(known.gain_angular, wi)))
        h = known.inner
        along: Scalar = 0.0
        if link.lanes[0] - 1 in rates:
            own = _linear_row(h, 2, vi, wi) if body.prismatic else _angular_row(h, 2, vi, wi)
            along = add(own, mul(body.armature, rate))
        hx, hy = (_linear_row(h, k, vi, wi) for k in (0, 1))
        if body.prismatic:
            # v × S = (ω × e_z, 0)
            force = sub(mul(wi[1], hx), mul(wi[0], hy))
            vi = [vi[0], vi[1], add(vi[2], rate)]
        else:
            # v × S = (v × e_z, ω × e_z)
            ax, ay = (_angular_row(h, k, vi, wi) for k in (0, 1))
            force = add(sub(mul(vi[1], hx), mul(vi[0], hy)), sub(mul(wi[1], ax), mul(wi[0], ay)))
            wi = [wi[0], wi[1], add(wi[2], rate)]
        vi, wi = known.step.moving.outward(vi, wi)
        v.append(vi)
        w.append(wi)
        for lane, k in enumerate(link.lanes):
            xdot[k - 1] = lanes.lane(rate, lane, len(link.lanes))
            pidot[k - 1] = lanes.lane(force, lane, len(link.lanes))
            if k - 1 in rates:
                momenta[k - 1] = lanes.lane(along, lane, len(link.lanes))
    return Swept(linear, angular, xdot, momenta, pidot)


def _eliminate(body: Body, a: Articulated, pi: Scalar, step: Step) -> Eliminated:
    """Solve the joint's own momentum equation for its velocity and put that into the rest."""
    if body.prismatic:
        U = [a.M[INDEX[k][2]] for k in range(3)]
        Ua = [a.B[k][2] for k in range(3)]
        D, u = add(a.M[5], body.armature), sub(pi, a.lin[2])
    else:
        U = [a.B[2][k] for k in range(3)]
        Ua = [a.I[INDEX[k][2]] for k in range(3)]
        D, u = add(a.I[5], body.armature), sub(pi, a.ang[2])
    inverse = 1.0 / D
    gain, gain_angular = [mul(c, inverse) for c in U], [mul(c, inverse) for c in Ua]
    drive = mul(u, inverse)
    # Without armature, what the joint moves along carries no inertia any more.
    free = isinstance(body.armature, float) and body.armature == 0.0
    pris = body.prismatic
    M, I = list(a.M), list(a.I)
    B = [list(row) for row in a.B]
    for i in range(3):
        for j in range(i, 3):
            gone = free and j == 2
            k = INDEX[i][j]
            M[k] = 0.0 if gone and pris else sub(a.M[k], mul(U[i], gain[j]))
            I[k] = 0.0 if gone and not pris else sub(a.I[k], mul(Ua[i], gain_angular[j]))
        for j in range(3):
            gone = free and (j == 2 if pris else i == 2)
            B[i][j] = 0.0 if gone else sub(a.B[i][j], mul(gain_angular[i], U[j]))
    lin = [add(a.lin[k], mul(U[k], drive)) for k in range(3)]
    ang = [add(a.ang[k], mul(Ua[k], drive)) for k in range(3)]
    if free:
        (lin if pris else ang)[2] = pi
    return Eliminated(Articulated(M, B, I, lin, ang), gain, gain_angular, drive, step)


def _drive(body: Body, a: Articulated, rate: Scalar, step: Step) -> Eliminated:
    """Carry a joint at a prescribed rate: its subtree is rigid, with the momentum of the rate."""
    if body.prismatic:
        U, Ua = [a.M[INDEX[k][2]] for k in range(3)], [a.B[k][2] for k in range(3)]
    else:
        U, Ua = [a.B[2][k] for k in range(3)], [a.I[INDEX[k][2]] for k in range(3)]
    lin = [add(a.lin[k], mul(U[k], rate)) for k in range(3)]
    ang = [add(a.ang[k], mul(Ua[k], rate)) for k in range(3)]
    none: Vec = [0.0, 0.0, 0.0]
    return Eliminated(Articulated(a.M, a.B, a.I, lin, ang), none, none, rate, step)


def step_of(body: Body, x: Scalar) -> Step:
    """Return the way to a body from its parent at joint value x."""
    return _step(body, _turned(body, x), x)


def _packed_step(link: Link, bodies: list[Body], x: list[Scalar], lanes: Lanes) -> Step:
    """Return the way to a link from its parent."""
    values = [x[k - 1] for k in link.lanes]
    turned = [_turned(bodies[k], value) for k, value in zip(link.lanes, values, strict=True)]
    c, s = (lanes.pack(numbers) for numbers in zip(*turned, strict=True))
    return _step(link.body, (c, s), lanes.pack(values) if link.body.prismatic else 0.0)


def _turned(body: Body, x: Scalar) -> tuple[Scalar, Scalar]:
    """Return cosine and sine of the angle about the body's z."""
    angle = body.offset if body.prismatic else x + body.offset if body.offset else x
    if isinstance(angle, float):
        return cosine(angle), sine(angle)
    return ca.cos(angle), ca.sin(angle)


def _step(body: Body, turned: tuple[Scalar, Scalar], slide: Scalar) -> Step:
    return Step(
        turns=[Turn(2, *body.beta), Turn(0, *body.alpha), Turn(2, *turned)],
        shift=body.r,
        slide=slide if body.prismatic else 0.0,
    )


def _carried(a: Articulated, step: Step) -> Articulated:
    """Return a subtree turned into the axes before a step and shifted to the origin there."""
    M, B, I = a.M, a.B, a.I
    if not isinstance(step.slide, float):
        B, I = _shifted(M, B, I, [0.0, 0.0, step.slide])
    for turn in reversed(step.turns):
        if not turn.is_none:
            M, B, I = turn.symmetric(M), turn.matrix(B), turn.symmetric(I)
    B, I = _shifted(M, B, I, step.shift)
    return Articulated(M, B, I, *step.inward(a.lin, a.ang))


def _add(parent: Articulated, a: Articulated, lanes: Lanes, width: int) -> None:
    """Add a subtree to its parent, or those in all lanes."""

    def both(p: Vec, q: Vec) -> Vec:
        return [add(x, lanes.sum(y, width)) for x, y in zip(p, q, strict=True)]

    parent.M, parent.I = both(parent.M, a.M), both(parent.I, a.I)
    parent.B = [both(p, q) for p, q in zip(parent.B, a.B, strict=True)]
    parent.lin, parent.ang = both(parent.lin, a.lin), both(parent.ang, a.ang)


def _shifted(M: Sym, B: Mat, I: Sym, r: Vec) -> tuple[Mat, Sym]:
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


def _linear_row(a: Articulated, k: int, v: Vec, w: Vec) -> Scalar:
    row = [mul(a.M[INDEX[k][j]], v[j]) for j in range(3)] + [mul(a.B[j][k], w[j]) for j in range(3)]
    return add(a.lin[k], total(row))


def _angular_row(a: Articulated, k: int, v: Vec, w: Vec) -> Scalar:
    row = [mul(a.B[k][j], v[j]) for j in range(3)] + [mul(a.I[INDEX[k][j]], w[j]) for j in range(3)]
    return add(a.ang[k], total(row))


def _solve_root(
    a: Articulated, mu: list[Scalar], axes: list[tuple[int, int]], armature: float
) -> tuple[Vec, Vec]:
    """Return the root's twist (linear, angular) from its momentum.

    axes: which entries of a twist there are, each as (0 or 1, axis): linear, or angular.
    """

    def entry(p: tuple[int, int], q: tuple[int, int]) -> Scalar:
        (ang_p, i), (ang_q, j) = p, q
        if ang_p and ang_q:
            return a.I[INDEX[i][j]]
        if not ang_p and not ang_q:
            return a.M[INDEX[i][j]]
        return a.B[i][j] if ang_p else a.B[j][i]

    A = [[entry(p, q) for q in axes] for p in axes]
    if armature:
        A[0][0] = add(A[0][0], armature)
    b = [sub(m, (a.ang if ang else a.lin)[k]) for m, (ang, k) in zip(mu, axes, strict=True)]
    solution = solve_ldl(A, b)
    linear: Vec = [0.0, 0.0, 0.0]
    angular: Vec = [0.0, 0.0, 0.0]
    for value, (ang, k) in zip(solution, axes, strict=True):
        (angular if ang else linear)[k] = value
    return linear, angular
