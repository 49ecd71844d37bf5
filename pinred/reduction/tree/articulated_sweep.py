"""Solve H(x) [ξ; ẋ] = [μ; π] and compute π̇ in one O(n) sweep, without the mass matrix.

The inward pass, from the leaves to the root, eliminates each joint from the articulated inertia of
its subtree, as in Featherstone's algorithm.  There are no bias forces, because only momenta are
needed.  At the root a linear system of the group's dimension is solved.  The outward pass, from the
root to the leaves, then computes the twists.
The momentum h_j of a subtree is its articulated inertia times the twist before its joint moves,
so that

    π̇_j = (v_j × S_j) · h_j

needs no second inward pass, and only two or four entries of h_j.  A ball is eliminated like three
hinges about the axes of its child, with no rotation between them.  For a ball

    π̇ = h_lin × v + h_ang × ω,   h_ang = π − armature · σ

with the rates σ in the axes of the child.  Joints that follow a common coordinate are eliminated
together (see coupled_groups.py).  Source: R. Featherstone, "Rigid Body Dynamics Algorithms", 2008,
ch. 7.

Elimination of the rate of one joint: with the momentum U of the subtree per unit rate, and D its
component along the rate, the rate is (π − momentum of the rest)/D.  The remaining inertia is
smaller by U Uᵀ/D.

Derivatives of (ξ, ẋ, π̇) with respect to (μ, x, π) follow by a recursion. The sweep computes the
derivatives ξ = ∂K/∂μ, ẋ = ∂K/∂π and π̇ = −∂K/∂x of the kinetic energy K = ½ (μ, π)·H⁻¹(x)(μ, π).
Its Jacobian consists of the second derivatives of K, so it is symmetric up to signs.  With H = Lᵀ D
L along the tree, ∂²K/∂(μ, π)² is the sum over pivots of u u′/D.  The column u of a momentum has
entries only at its joint, at the ancestors and at the root.

A change of the angle of joint j moves its subtree rigidly.  The equations inside the subtree stay
the same, if its twists are taken relative to U = S × v, with the axis S of the joint.  Outside, the
change acts like the momentum

    e = S ×* h − Pᵃ U

with the momentum h of the subtree and its inertia Pᵃ after the elimination of joint j.  The column
of an angle is that of e, and ∂²K/∂x∂(x, π) is a sum of the same form.  For joint j and the joints
behind it, the product of U and their momentum at the parent of j is added.  All vectors are in the
frame of the root body, where paths need no transformations.  J. Carpentier, N. Mansard,
"Analytical derivatives of rigid body dynamics algorithms", RSS 2018, differentiate accelerations.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import casadi as ca

from ...system.coupling import Coupled
from .body_frames import (
    Articulated,
    Body,
    Freedom,
    Step,
    angular_row,
    carried,
    cosine,
    linear_row,
    momentum_of_rate,
    rigid,
    sine,
)
from .coupled_groups import Groups
from .identical_branches import Lanes, Link, from_parents, links_of, to_parents
from .scalars import (
    INDEX,
    Mat,
    Rotation,
    Scalar,
    Turn,
    Vec,
    add,
    cross,
    dot,
    factor_ldl,
    mul,
    plus,
    quaternion_matrix,
    solve_factored,
    solve_lower,
    sub,
    total,
)


@dataclass
class Rate:
    """A rate of an eliminated joint: drive − gain · v − gain_angular · ω.

    Attributes:
        axis: Axis of the rate.
        gain: Linear part of U/D, (3,).
        gain_angular: Angular part of U/D, (3,).
        drive: Rate u/D at zero twist.
        momentum: Momentum u, which remains of π when the subtree takes its part.
        inverse: 1/D.
    """

    axis: int
    gain: Vec
    gain_angular: Vec
    drive: Scalar
    momentum: Scalar = 0.0
    inverse: Scalar = 0.0

    def at(self, v: Vec, w: Vec) -> Scalar:
        """Return the rate at the twist (v, w) before the joint moves."""
        return sub(self.drive, add(dot(self.gain, v), dot(self.gain_angular, w)))


@dataclass
class Eliminated:
    """Data of an eliminated joint for the outward pass, in the body's frame at joint value zero.

    Attributes:
        inner: Inertia of the subtree with the joint's velocity eliminated.
        rates: Rates of the joint, in the order of elimination.
        step: Step from the parent's frame to the body's frame.
    """

    inner: Articulated
    rates: list[Rate]
    step: Step


def eliminate_rate(freedom: Freedom, a: Articulated, pi: Scalar) -> tuple[Articulated, Rate]:
    """Eliminate a joint's rate with its momentum equation; a: inertia of the subtree."""
    U, Ua = momentum_of_rate(freedom, a)
    D = add(freedom.along(U, Ua), freedom.armature)
    u = sub(pi, freedom.along(a.lin, a.ang))
    inverse = 1.0 / D
    gain, gain_angular = [mul(c, inverse) for c in U], [mul(c, inverse) for c in Ua]
    drive = mul(u, inverse)
    # Without armature, the eliminated inertia vanishes exactly along the joint's axis.
    free = isinstance(freedom.armature, float) and freedom.armature == 0.0
    slides, axis = freedom.slides, freedom.axis
    M, I = list(a.M), list(a.I)
    B = [list(row) for row in a.B]
    for i in range(3):
        for j in range(i, 3):
            vanishes = free and axis in (i, j)
            k = INDEX[i][j]
            M[k] = 0.0 if vanishes and slides else sub(a.M[k], mul(U[i], gain[j]))
            I[k] = 0.0 if vanishes and not slides else sub(a.I[k], mul(Ua[i], gain_angular[j]))
        for j in range(3):
            vanishes = free and (j == axis if slides else i == axis)
            B[i][j] = 0.0 if vanishes else sub(a.B[i][j], mul(gain_angular[i], U[j]))
    lin = [add(a.lin[k], mul(U[k], drive)) for k in range(3)]
    ang = [add(a.ang[k], mul(Ua[k], drive)) for k in range(3)]
    if free:
        (lin if slides else ang)[axis] = pi
    return Articulated(M, B, I, lin, ang), Rate(axis, gain, gain_angular, drive, u, inverse)


def join_groups(groups: Groups, i: int, freedom: Freedom, a: Articulated, step: Step) -> Eliminated:
    """Pass a joint's rate on to its groups, except a prescribed part; a: inertia of the subtree."""
    rate = groups.pushed.get(groups.number(i))
    if rate is None:
        none: Vec = [0.0, 0.0, 0.0]
        joint = Eliminated(a, [Rate(freedom.axis, none, none, 0.0)], step)
    else:
        joint = prescribe_rate(freedom, Eliminated(a, [], step), rate)
        groups.drive(i, freedom, rate)
    groups.join(i, freedom, joint.inner)
    return joint


def prescribe_rate(freedom: Freedom, joint: Eliminated, rate: Scalar) -> Eliminated:
    """Prescribe a rate of a joint: add its momentum to the subtree's."""
    a = joint.inner
    U, Ua = momentum_of_rate(freedom, a)
    lin = [add(a.lin[k], mul(U[k], rate)) for k in range(3)]
    ang = [add(a.ang[k], mul(Ua[k], rate)) for k in range(3)]
    none: Vec = [0.0, 0.0, 0.0]
    driven = Rate(freedom.axis, none, none, rate)
    return Eliminated(Articulated(a.M, a.B, a.I, lin, ang), [*joint.rates, driven], joint.step)


@dataclass
class Swept:
    """Results of the sweep.

    Attributes:
        root_linear: Linear velocity of the root body.
        root_angular: Angular velocity of the root body.
        xdot: Shape rates.
        pi: Canonical momenta; the sweep computes the momenta of prescribed coordinates.
        pidot: Rates of the canonical momenta without forces.
        factors: Pairs (u, u/D) of all eliminated rates, then of the root, from H = L D Lᵀ with
            u = L⁻¹(μ, π).  So (μ, π)·H⁻¹(μ, π)' is the sum of u u'/D, without an outward pass.
            They are complete if no joints follow others.
        links: The links of the sweep, root first.
        joints: The eliminated joint of each link; None at the root.
        twists: Twist of each link before its joint moves, (linear, angular), in the frame of the
            joint at rest; the root's twist first.
        root: Entries of L below the unit diagonal, and 1/D, of the root's inertia L D Lᵀ.
    """

    root_linear: Vec
    root_angular: Vec
    xdot: list[Scalar]
    pi: list[Scalar]
    pidot: list[Scalar]
    factors: list[tuple[Scalar, Scalar]]
    links: list[Link]
    joints: list[Eliminated | None]
    twists: list[tuple[Vec, Vec]]
    root: tuple[list[Vec], Vec]


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
        x: Coordinates of all tree joints.
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
    links = links_of(bodies, lanes, {*groups.driven, *groups.driven_balls}, groups.members)
    lanes = lanes or Lanes()
    groups.meet(links)
    inertia = [rigid(link.body) for link in links]
    joints: list[Eliminated | None] = [None] * len(links)
    for i in range(len(links) - 1, 0, -1):
        link, k = links[i], links[i].lanes[0]
        groups.close(i, inertia[i], pi)
        step = _packed_step(link, bodies, x, lanes)
        # The joint's motion is separated from the rest of the step, since it leaves the joint axis
        # fixed: the division by D then need not wait for sine and cosine of the joint angle.  The
        # rates of a ball refer to the axes of its child.
        outer = step if link.body.is_ball else step.fixed
        inner = inertia[i]
        if not link.body.is_ball:
            inner = carried(inertia[i], step.moving)
            groups.carry(i, step.moving)
        (freedom, *_) = freedoms = link.body.freedoms
        if k in groups.driven or k in groups.driven_balls:
            joint = Eliminated(inner, [], step)
            for freedom, rate in zip(freedoms, _driven_rates(groups, link, lanes), strict=True):
                joint = prescribe_rate(freedom, joint, rate)
                groups.drive(i, freedom, rate)
        elif k in groups.members:
            joint = join_groups(groups, i, freedom, inner, step)
        else:
            joint = Eliminated(inner, [], step)
            for freedom, momentum in zip(freedoms, _momenta(groups, link, pi, lanes), strict=True):
                remainder, solved_rate = eliminate_rate(freedom, joint.inner, momentum)
                groups.eliminate(i, freedom, joint.inner, solved_rate.drive)
                joint = Eliminated(remainder, [*joint.rates, solved_rate], step)
        joints[i] = joint
        _add_to_parents(link, links, carried(joint.inner, outer), inertia, lanes)
        groups.add_to_parent(i, link.parent, outer)
    groups.close(0, inertia[0], pi)
    factors = [
        (rate.momentum, rate.drive) for joint in joints if joint is not None for rate in joint.rates
    ]
    linear, angular, root_factors, root = _solve_root(
        inertia[0], mu, [divmod(k, 3) for k in axes], root_armature
    )
    factors += root_factors
    v, w, twists = [linear], [angular], [(linear, angular)]
    groups.find_rates(0, linear, angular)
    xdot: list[Scalar] = [0.0] * len(pi)
    momenta = [0.0 if k in rates else momentum for k, momentum in enumerate(pi)]
    pidot: list[Scalar] = [0.0] * len(pi)
    for i in range(1, len(links)):
        link, body, solved = links[i], links[i].body, joints[i]
        assert solved is not None
        vi, wi = (from_parents(link, links, values, lanes) for values in (v, w))
        vi, wi = solved.step.fixed.outward(vi, wi)
        twists.append((vi, wi))
        if body.is_ball:
            vi, wi, *columns = _move_ball(groups, i, link, solved, (vi, wi), pi, lanes)
            groups.find_rates(i, vi, wi)
            v.append(vi)
            w.append(wi)
            for values, column in zip((xdot, momenta, pidot), columns, strict=True):
                for lane, j in enumerate(link.lanes):
                    for axis in range(3):
                        number = lanes.lane(column[axis], lane, len(link.lanes))
                        values[groups.balls[j] + axis] = number
            continue
        (solved_rate,) = solved.rates
        rate = groups.rate(i, solved_rate.at(vi, wi), solved_rate.axis)
        h = solved.inner
        joint_momentum: Scalar = 0.0  # momentum of the subtree along a prescribed joint
        if groups.is_driven(link.lanes[0]):
            joint_momentum = (
                linear_row(h, 2, vi, wi) if body.prismatic else angular_row(h, 2, vi, wi)
            )
            joint_momentum = add(joint_momentum, groups.momentum(i, 2, angular=not body.prismatic))
            joint_momentum = add(joint_momentum, mul(body.armature, rate))
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
                    lane_momentum = lanes.lane(joint_momentum, lane, len(link.lanes))
                    momenta[k] = add(momenta[k], mul(ratio, lane_momentum))
    return Swept(linear, angular, xdot, momenta, pidot, factors, links, joints, twists, root)


def _momenta(groups: Groups, link: Link, pi: list[Scalar], lanes: Lanes) -> list[Scalar]:
    """Return the canonical momenta of a link's joint in the axes of its body frame."""
    if link.lanes[0] not in groups.balls:
        return [lanes.pack([pi[groups.terms[j][0][0]] for j in link.lanes])]
    first = [groups.balls[j] for j in link.lanes]
    return link.body.to_frame([lanes.pack([pi[k + axis] for k in first]) for axis in range(3)])


def _driven_rates(groups: Groups, link: Link, lanes: Lanes) -> list[Scalar]:
    """Return the prescribed rates of a link's joint in the axes of its body frame."""
    if link.lanes[0] in groups.driven:
        return [lanes.pack([groups.driven[j] for j in link.lanes])]
    rates = [groups.driven_balls[j] for j in link.lanes]
    return link.body.to_frame([lanes.pack([rate[axis] for rate in rates]) for axis in range(3)])


def _move_ball(
    groups: Groups,
    i: int,
    link: Link,
    joint: Eliminated,
    twist: tuple[Vec, Vec],
    pi: list[Scalar],
    lanes: Lanes,
) -> tuple[Vec, Vec, Vec, Vec, Vec]:
    """Compute the motion of a ball in the outward pass.

    Args:
        groups: Groups of the sweep.
        i: Index of the link.
        link: The link.
        joint: The eliminated ball.
        twist: Linear and angular velocity before the ball moves, in the axes of the parent at rest.
        pi: Canonical momenta of the shape.
        lanes: Record of SIMD lanes.
    Returns:
        Linear and angular velocity of the body, in its axes; and, in the axes of Pinocchio's joint,
        rates, canonical momenta and rates of the canonical momenta of the ball, (3,) each.
    """
    body = link.body
    v, before = joint.step.moving.outward(*twist)
    w, sigma = list(before), [0.0] * 3
    for solved in reversed(joint.rates):
        sigma[solved.axis] = groups.rate(i, solved.at(v, w), solved.axis)
        w[solved.axis] = add(w[solved.axis], sigma[solved.axis])
    linear = [add(linear_row(joint.inner, k, v, before), groups.momentum(i, k)) for k in range(3)]
    armature = [mul(body.armature, rate) for rate in sigma]
    if link.lanes[0] in groups.driven_balls:
        momenta_at_rest = [angular_row(joint.inner, k, v, before) for k in range(3)]
        angular = [
            add(h, groups.momentum(i, k, angular=True)) for k, h in enumerate(momenta_at_rest)
        ]
        momentum = plus(angular, armature)
    else:
        momentum = _momenta(groups, link, pi, lanes)
        angular = [sub(p, rotor) for p, rotor in zip(momentum, armature, strict=True)]
    torque = plus(cross(linear, v), cross(angular, w))
    sigma, momentum, torque = (body.to_joint(column) for column in (sigma, momentum, torque))
    return v, w, sigma, momentum, torque


def step_of(body: Body, x: Sequence[Scalar]) -> Step:
    """Return the step to a body from its parent; x: coordinates of all tree joints."""
    if body.is_ball:
        return _ball_step(body, x[body.x_at : body.x_at + 4])
    value = x[body.x_at]
    return _step(body, _cosine_and_sine(body, value), value)


def _packed_step(link: Link, bodies: list[Body], x: list[Scalar], lanes: Lanes) -> Step:
    """Return the step to a link, packed into lanes; x: coordinates of all tree joints."""
    if link.body.is_ball:
        first = [bodies[k].x_at for k in link.lanes]
        return _ball_step(link.body, [lanes.pack([x[k + n] for k in first]) for n in range(4)])
    values = [x[bodies[k].x_at] for k in link.lanes]
    pairs = [_cosine_and_sine(bodies[k], x) for k, x in zip(link.lanes, values, strict=True)]
    c, s = (lanes.pack(numbers) for numbers in zip(*pairs, strict=True))
    return _step(link.body, (c, s), lanes.pack(values) if link.body.prismatic else 0.0)


def _ball_step(body: Body, q: Sequence[Scalar]) -> Step:
    """Return the step to the body of a ball; q: its quaternion in Pinocchio's joint frame."""
    c, s = _cosine_and_sine(body, 0.0)
    constant = [Turn(2, *body.beta), Turn(0, *body.alpha), Turn(1, *body.delta), Turn(2, c, s)]
    moving = Rotation(quaternion_matrix([*body.to_frame(q[:3]), q[3]]))
    return Step(turns=[*constant, moving], shift=body.r, slide=0.0)


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


def _add_to_parents(
    link: Link, links: list[Link], a: Articulated, inertia: list[Articulated], lanes: Lanes
) -> None:
    """Add the inertia of the subtree of a link to the inertias of its parents."""
    sums = [to_parents(link, links, block, lanes) for block in (a.M, a.I, *a.B, a.lin, a.ang)]
    for i in sums[0]:
        M, I, *B, lin, ang = (block[i] for block in sums)
        parent = inertia[i]
        parent.M, parent.I = plus(parent.M, M), plus(parent.I, I)
        parent.B = [plus(p, q) for p, q in zip(parent.B, B, strict=True)]
        parent.lin, parent.ang = plus(parent.lin, lin), plus(parent.ang, ang)


def _solve_root(
    a: Articulated, mu: list[Scalar], axes: list[tuple[int, int]], armature: float
) -> tuple[Vec, Vec, list[tuple[Scalar, Scalar]], tuple[list[Vec], Vec]]:
    """Return the root's twist (linear, angular), solved from its momentum, and its factors twice.

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
    L, _, inverse = factor_ldl(A)
    solution = solve_factored(L, inverse, b)
    u = solve_lower(L, b)
    factors = [(c, mul(c, d)) for c, d in zip(u, inverse, strict=True)]
    linear: Vec = [0.0, 0.0, 0.0]
    angular: Vec = [0.0, 0.0, 0.0]
    for value, (ang, k) in zip(solution, axes, strict=True):
        (angular if ang else linear)[k] = value
    return linear, angular, factors, (L, inverse)


@dataclass
class _Frame:
    """Rotation R to the root's axes, by rows, and origin p of a frame, in the root's frame."""

    R: Mat
    p: Vec

    def after(self, step: Step) -> _Frame:
        """Return the frame that a step leads to."""
        p, R = plus(self.p, [dot(row, step.shift) for row in self.R]), self.R
        for turn in step.turns:
            if not turn.is_none:
                R = [turn.back(row) for row in R]
        return _Frame(R, plus(p, [mul(row[2], step.slide) for row in R]))

    def momentum(self, lin: Vec, ang: Vec) -> Vec:
        """Transform a momentum to the root's frame, (6,)."""
        lin, ang = ([dot(row, v) for row in self.R] for v in (lin, ang))
        return [*lin, *plus(ang, cross(self.p, lin))]

    def twist(self, v: Vec, w: Vec) -> Vec:
        """Transform a twist to the root's frame, (6,)."""
        v, w = ([dot(row, c) for row in self.R] for c in (v, w))
        return [*plus(v, cross(self.p, w)), *w]


@dataclass
class _Joint:
    """Vectors of a joint in the root's frame, (6,) each; in lanes if its link is.

    Attributes:
        S: Twist of the joint per unit rate.
        U: Derivative S × v of the twist of its subtree by its angle.
        gain: Momentum of its subtree per unit rate, divided by the joint's inertia D.
        e: Momentum that a change of its angle adds to its parent.
        inverse: 1/D.
    """

    S: Vec
    U: Vec
    gain: Vec
    e: Vec
    inverse: Scalar


@dataclass
class _Column:
    """A column of L⁻ᵀ, for a momentum or an angle.

    Attributes:
        root: Entries at the root, (r,).
        at: Entries at joints, by link; by body after lanes were separated.
        momentum: Momentum, (6,), that arrives at the parent of each joint on the path, by link.
    """

    root: Vec = field(default_factory=list)
    at: dict[int, Scalar] = field(default_factory=dict)
    momentum: dict[int, Vec] = field(default_factory=dict)


def sweep_jacobian(swept: Swept, bodies: Sequence[Body], axes: Sequence[int], lanes: Lanes) -> Mat:
    """Return the derivatives of the results of a sweep without balls, couplings and loops.

    Args:
        swept: Results of the sweep; no rate was prescribed.
        bodies: Bodies of the tree, root first.
        axes: Axes of the group (see Group).
        lanes: Lanes of the sweep.
    Returns:
        (r + 2 m, r + 2 m): derivatives of (ξ, ẋ, π̇) with respect to (μ, x, π).
    """
    r, m = len(axes), len(bodies) - 1
    links, joints, (L, inverse) = swept.links, _joints_of(swept), swept.root
    # The columns, in the order (μ, x, π), and their products with U of the joints on the path.
    columns = [_Column(solve_lower(L, [float(a == k) for k in range(r)])) for a in range(r)]
    columns += [_Column()] * (2 * m)
    coupling: dict[tuple[int, int], Scalar] = {}
    pivots: dict[int, Scalar] = {}
    at = [-1, *(r + body.v_at for body in bodies[1:])]  # index of the column of each body's angle
    for i in range(1, len(links)):
        width = len(links[i].lanes)
        for shift, start in ((0, _Column()), (m, _Column(at={i: 1.0}))):
            first = joints[i].gain if shift else joints[i].e
            column = _run_inward(start, i, first, links, joints, axes, L)
            products = {k: dot(b, joints[k].U) for k, b in column.momentum.items()}
            for lane, body in enumerate(links[i].lanes):
                taken = {
                    _body(links[k], lane): lanes.lane(u, lane, width) for k, u in column.at.items()
                }
                root = [lanes.lane(u, lane, width) for u in column.root]
                columns[at[body] + shift] = _Column(root, taken)
                for k, product in products.items():
                    place = at[body] + shift, at[_body(links[k], lane)]
                    coupling[place] = lanes.lane(product, lane, width)
        for lane, body in enumerate(links[i].lanes):
            pivots[body] = lanes.lane(joints[i].inverse, lane, width)
    scaled = [
        _Column(
            [mul(u, d) for u, d in zip(column.root, inverse, strict=True)],
            {body: mul(u, pivots[body]) for body, u in column.at.items()},
        )
        for column in columns
    ]
    size = r + 2 * m
    K: Mat = [[0.0] * size for _ in range(size)]  # second derivatives of K, in the order (μ, x, π)
    for a in range(size):
        for b in range(a, size):
            along = coupling.get((a, b), coupling.get((b, a), 0.0))
            K[a][b] = K[b][a] = add(_product(columns[a], scaled[b]), along)
    return [
        *K[:r],
        *K[r + m :],
        *([mul(-1.0, entry) for entry in row] for row in K[r : r + m]),
    ]


def _body(link: Link, lane: int) -> int:
    return link.lanes[lane if len(link.lanes) > 1 else 0]


def _product(a: _Column, b: _Column) -> Scalar:
    """Return the sum of the products of entries that two columns have in common."""
    return add(dot(a.root, b.root), total([mul(u, b.at[k]) for k, u in a.at.items() if k in b.at]))


def _run_inward(
    column: _Column,
    i: int,
    momentum: Vec,
    links: Sequence[Link],
    joints: Sequence[_Joint],
    axes: Sequence[int],
    L: list[Vec],
) -> _Column:
    """Fill a column along the path from link i to the root; momentum: (6,) at the parent of i."""
    column.momentum[i] = momentum
    while i := links[i].parent:
        joint = joints[i]
        column.at[i] = mul(-1.0, dot(joint.S, momentum))
        momentum = plus(momentum, [mul(column.at[i], c) for c in joint.gain])
        column.momentum[i] = momentum
    column.root = solve_lower(L, [mul(-1.0, momentum[axis]) for axis in axes])
    return column


def _joints_of(swept: Swept) -> list[_Joint]:
    """Return the vectors of all joints, by link; a placeholder at the root."""
    none: Vec = [0.0, 0.0, 0.0]
    identity = [[float(a == b) for b in range(3)] for a in range(3)]
    frames, joints = [_Frame(identity, none)], [_Joint([], [], [], [], 0.0)]
    for i in range(1, len(swept.links)):
        link, joint = swept.links[i], swept.joints[i]
        assert joint is not None
        before = frames[link.parent].after(joint.step.fixed)
        frames.append(before.after(joint.step.moving))
        joints.append(_joint(link, joint, swept.twists[i], before))
    return joints


def _joint(link: Link, joint: Eliminated, twist: tuple[Vec, Vec], rest: _Frame) -> _Joint:
    """Compute the vectors of a joint about the z axis of its frame `rest`."""
    (v, w), none, z, inner = twist, [0.0, 0.0, 0.0], [0.0, 0.0, 1.0], joint.inner
    (rate,) = joint.rates
    h = [linear_row(inner, k, v, w) for k in (0, 1)]
    gyroscopic: Vec = [mul(-1.0, h[1]), h[0], 0.0]
    if link.body.prismatic:
        S, U, force = rest.twist(z, none), (cross(z, w), none), (none, gyroscopic)
    else:
        k = [angular_row(inner, axis, v, w) for axis in (0, 1)]
        S, U = rest.twist(none, z), (cross(z, v), cross(z, w))
        force = gyroscopic, [mul(-1.0, k[1]), k[0], 0.0]
    plain = Articulated(inner.M, inner.B, inner.I, none, none)
    inertial = (
        [linear_row(plain, k, *U) for k in range(3)],
        [angular_row(plain, k, *U) for k in range(3)],
    )
    e = [
        [sub(a, b) for a, b in zip(*pair, strict=True)]
        for pair in zip(force, inertial, strict=True)
    ]
    return _Joint(
        S, rest.twist(*U), rest.momentum(rate.gain, rate.gain_angular), rest.momentum(*e),
        rate.inverse,
    )  # fmt: skip
