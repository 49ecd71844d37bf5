"""Solve H(x) [ξ; ẋ] = [μ; π] and compute π̇ in one O(n) sweep, without the mass matrix.

The inward pass, from the leaves to the root, eliminates each joint from the articulated inertia of
its subtree, as in Featherstone's algorithm.  There are no bias forces, because only momenta are
needed.  At the root a linear system of the group's dimension is solved.  The outward pass, from the
root to the leaves, then computes the twists.
The momentum h_j of a subtree is its articulated inertia times the twist before its joint moves,
so that

    π̇_j = (v_j × S_j) · h_j

needs no second inward pass, and only two or four entries of h_j.  Joints that follow a common
coordinate are eliminated together (see coupled_groups.py).  Source: R. Featherstone, "Rigid Body
Dynamics Algorithms", 2008, ch. 7.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

from ...system.coupling import Coupled
from .articulated_body import (
    Articulated,
    Step,
    along_joint,
    angular_row,
    carried,
    linear_row,
    momentum_of_rate,
    rigid,
)
from .body_frames import Body, cosine, sine
from .coupled_groups import Groups
from .identical_branches import Lanes, Link, links_of
from .scalars import INDEX, Scalar, Turn, Vec, add, dot, mul, solve_ldl, sub


@dataclass
class Eliminated:
    """Data of an eliminated joint for the outward pass, in the body's frame at joint value zero.

    Attributes:
        inner: Inertia of the subtree with the joint's velocity eliminated.
        gain: Linear part of U/D, (3,); the joint rate is drive − gain · v − gain_angular · ω.
        gain_angular: Angular part of U/D, (3,).
        drive: Joint rate u/D at zero twist.
        step: Step from the parent's frame to the body's frame.
    """

    inner: Articulated
    gain: Vec
    gain_angular: Vec
    drive: Scalar
    step: Step


@dataclass
class Swept:
    """Results of the sweep.

    Attributes:
        root_linear: Linear velocity of the root body.
        root_angular: Angular velocity of the root body.
        xdot: Shape rates.
        pi: Canonical momenta; the sweep computes the momenta of prescribed coordinates.
        pidot: Rates of the canonical momenta without forces.
    """

    root_linear: Vec
    root_angular: Vec
    xdot: list[Scalar]
    pi: list[Scalar]
    pidot: list[Scalar]


def sweep(
    bodies: list[Body],
    x: list[Scalar],
    pi: list[Scalar],
    mu: list[Scalar],
    axes: Sequence[int],
    root_armature: float,
    rates: Mapping[int, Scalar],
    lanes: Lanes | None = None,
    coupled: Coupled | None = None,
) -> Swept:
    """Solve H v = (μ, π) for the velocities, and compute π̇ without forces.

    Args:
        bodies: Bodies of the tree, root first.
        x: Values of all tree joints.
        pi: Canonical momenta of the shape coordinates.
        mu: Body momentum, (r,).
        axes: Axes of the group (see Group).
        root_armature: Armature of the root joint, added to the locked inertia of SO(2).
        rates: Rates of the prescribed coordinates, by index; their π is not read.
        lanes: Record of SIMD lanes in which identical branches are computed together;
            None: no lanes.
        coupled: Coupling of joints that follow others; None if no joint follows another.
    Returns:
        Velocities, momenta and rates.
    """
    groups = Groups(bodies, rates, coupled)
    links = links_of(bodies, lanes, groups.driven, groups.members)
    lanes = lanes or Lanes()
    groups.meet(links)
    inertia = [rigid(link.body) for link in links]
    joints: list[Eliminated | None] = [None] * len(links)
    for i in range(len(links) - 1, 0, -1):
        link, k = links[i], links[i].lanes[0]
        groups.close(i, inertia[i], pi)
        step = _packed_step(link, bodies, x, lanes)
        # The joint's motion is separated from the rest of the step, since it leaves the joint axis
        # fixed: the division by D then need not wait for sine and cosine of the joint angle.
        inner = carried(inertia[i], step.moving)
        groups.carry(i, step.moving)
        if k in groups.driven:
            rate = lanes.pack([groups.driven[j] for j in link.lanes])
            joint = _drive(link.body, inner, rate, step)
            groups.drive(i, link.body, rate)
        elif k in groups.members:
            joint = _join(groups, i, link.body, inner, step)
        else:
            momentum = lanes.pack([pi[groups.terms[j][0][0]] for j in link.lanes])
            joint = _eliminate(link.body, inner, momentum, step)
            groups.eliminate(i, link.body, inner, joint.drive)
        joints[i] = joint
        width = len(link.lanes) if len(links[link.parent].lanes) == 1 else 1
        _add(inertia[link.parent], carried(joint.inner, step.fixed), lanes, width)
        groups.add_to_parent(i, link.parent, step.fixed)
    groups.close(0, inertia[0], pi)
    linear, angular = _solve_root(inertia[0], mu, [divmod(k, 3) for k in axes], root_armature)
    v, w = [linear], [angular]
    groups.find_rates(0, linear, angular)
    xdot: list[Scalar] = [0.0] * len(pi)
    momenta = [0.0 if k in rates else momentum for k, momentum in enumerate(pi)]
    pidot: list[Scalar] = [0.0] * len(pi)
    for i in range(1, len(links)):
        link, body, solved = links[i], links[i].body, joints[i]
        assert solved is not None
        vi, wi = solved.step.fixed.outward(v[link.parent], w[link.parent])
        rate = sub(solved.drive, add(dot(solved.gain, vi), dot(solved.gain_angular, wi)))
        rate = groups.rate(i, rate)
        h = solved.inner
        along: Scalar = 0.0  # momentum of the subtree along a prescribed joint
        if groups.is_driven(link.lanes[0]):
            along = linear_row(h, 2, vi, wi) if body.prismatic else angular_row(h, 2, vi, wi)
            along = add(along, groups.momentum(i, 2, angular=not body.prismatic))
            along = add(along, mul(body.armature, rate))
        hx, hy = (add(linear_row(h, k, vi, wi), groups.momentum(i, k)) for k in (0, 1))
        if body.prismatic:
            # v × S = (ω × e_z, 0)
            force = sub(mul(wi[1], hx), mul(wi[0], hy))
            vi = [vi[0], vi[1], add(vi[2], rate)]
        else:
            # v × S = (v × e_z, ω × e_z)
            ax, ay = (
                add(angular_row(h, k, vi, wi), groups.momentum(i, k, angular=True)) for k in (0, 1)
            )
            force = add(sub(mul(vi[1], hx), mul(vi[0], hy)), sub(mul(wi[1], ax), mul(wi[0], ay)))
            wi = [wi[0], wi[1], add(wi[2], rate)]
        vi, wi = solved.step.moving.outward(vi, wi)
        groups.find_rates(i, vi, wi)
        v.append(vi)
        w.append(wi)
        for lane, j in enumerate(link.lanes):
            if groups.leads(j):
                xdot[groups.terms[j][0][0]] = lanes.lane(rate, lane, len(link.lanes))
            own_force = lanes.lane(force, lane, len(link.lanes))
            for k, ratio in groups.terms[j]:
                pidot[k] = add(pidot[k], mul(ratio, own_force))
                if k in rates:
                    own = lanes.lane(along, lane, len(link.lanes))
                    momenta[k] = add(momenta[k], mul(ratio, own))
    return Swept(linear, angular, xdot, momenta, pidot)


def _eliminate(body: Body, a: Articulated, pi: Scalar, step: Step) -> Eliminated:
    """Eliminate a joint's rate with its momentum equation; a: inertia of the subtree."""
    U, Ua = momentum_of_rate(body, a)
    D = add(along_joint(body, U, Ua), body.armature)
    u = sub(pi, along_joint(body, a.lin, a.ang))
    inverse = 1.0 / D
    gain, gain_angular = [mul(c, inverse) for c in U], [mul(c, inverse) for c in Ua]
    drive = mul(u, inverse)
    # Without armature, the eliminated inertia vanishes exactly along the joint's axis.
    free = isinstance(body.armature, float) and body.armature == 0.0
    pris = body.prismatic
    M, I = list(a.M), list(a.I)
    B = [list(row) for row in a.B]
    for i in range(3):
        for j in range(i, 3):
            vanishes = free and j == 2
            k = INDEX[i][j]
            M[k] = 0.0 if vanishes and pris else sub(a.M[k], mul(U[i], gain[j]))
            I[k] = 0.0 if vanishes and not pris else sub(a.I[k], mul(Ua[i], gain_angular[j]))
        for j in range(3):
            vanishes = free and (j == 2 if pris else i == 2)
            B[i][j] = 0.0 if vanishes else sub(a.B[i][j], mul(gain_angular[i], U[j]))
    lin = [add(a.lin[k], mul(U[k], drive)) for k in range(3)]
    ang = [add(a.ang[k], mul(Ua[k], drive)) for k in range(3)]
    if free:
        (lin if pris else ang)[2] = pi
    return Eliminated(Articulated(M, B, I, lin, ang), gain, gain_angular, drive, step)


def _join(groups: Groups, i: int, body: Body, a: Articulated, step: Step) -> Eliminated:
    """Pass a joint's rate on to its groups, except a prescribed part; a: inertia of the subtree."""
    rate = groups.pushed.get(groups.number(i))
    if rate is None:
        none: Vec = [0.0, 0.0, 0.0]
        joint = Eliminated(a, none, none, 0.0, step)
    else:
        joint = _drive(body, a, rate, step)
        groups.drive(i, body, rate)
    groups.join(i, body, joint.inner)
    return joint


def _drive(body: Body, a: Articulated, rate: Scalar, step: Step) -> Eliminated:
    """Prescribe a joint's rate: add its momentum to the subtree's; a: inertia of the subtree."""
    U, Ua = momentum_of_rate(body, a)
    lin = [add(a.lin[k], mul(U[k], rate)) for k in range(3)]
    ang = [add(a.ang[k], mul(Ua[k], rate)) for k in range(3)]
    none: Vec = [0.0, 0.0, 0.0]
    return Eliminated(Articulated(a.M, a.B, a.I, lin, ang), none, none, rate, step)


def step_of(body: Body, x: Scalar) -> Step:
    """Return the step to a body from its parent at joint value x."""
    return _step(body, _cosine_and_sine(body, x), x)


def _packed_step(link: Link, bodies: list[Body], x: list[Scalar], lanes: Lanes) -> Step:
    """Return the step to a link from its parent, packed into lanes; x: values of all joints."""
    values = [x[k - 1] for k in link.lanes]
    pairs = [_cosine_and_sine(bodies[k], x) for k, x in zip(link.lanes, values, strict=True)]
    c, s = (lanes.pack(numbers) for numbers in zip(*pairs, strict=True))
    return _step(link.body, (c, s), lanes.pack(values) if link.body.prismatic else 0.0)


def _cosine_and_sine(body: Body, x: Scalar) -> tuple[Scalar, Scalar]:
    """Return cosine and sine of the angle about the body's z at joint value x."""
    none = isinstance(body.offset, float) and body.offset == 0.0
    angle = body.offset if body.prismatic else x if none else x + body.offset
    if isinstance(angle, float):
        return cosine(angle), sine(angle)
    return ca.cos(angle), ca.sin(angle)


def _step(body: Body, angle: tuple[Scalar, Scalar], slide: Scalar) -> Step:
    """Return the step of a body; angle: cosine and sine of the angle about the body's z."""
    return Step(
        turns=[Turn(2, *body.beta), Turn(0, *body.alpha), Turn(1, *body.delta), Turn(2, *angle)],
        shift=body.r,
        slide=slide if body.prismatic else 0.0,
    )


def _add(parent: Articulated, a: Articulated, lanes: Lanes, width: int) -> None:
    """Add the inertia of a subtree, summed over the lanes, to the inertia of its parent."""

    def both(p: Vec, q: Vec) -> Vec:
        return [add(x, lanes.sum(y, width)) for x, y in zip(p, q, strict=True)]

    parent.M, parent.I = both(parent.M, a.M), both(parent.I, a.I)
    parent.B = [both(p, q) for p, q in zip(parent.B, a.B, strict=True)]
    parent.lin, parent.ang = both(parent.lin, a.lin), both(parent.ang, a.ang)


def _solve_root(
    a: Articulated, mu: list[Scalar], axes: list[tuple[int, int]], armature: float
) -> tuple[Vec, Vec]:
    """Return the root's twist (linear, angular), solved from its momentum.

    axes: entries of the group's twists, each as (0 for linear or 1 for angular, axis).
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
