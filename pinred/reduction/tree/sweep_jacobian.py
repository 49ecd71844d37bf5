"""Derivatives of the sweep's results (ξ, ẋ, π̇) with respect to (μ, x, π), by a recursion.

The sweep computes the derivatives ξ = ∂K/∂μ, ẋ = ∂K/∂π and π̇ = −∂K/∂x of the kinetic energy
K = ½ (μ, π)·H⁻¹(x)(μ, π).  Its Jacobian consists of the second derivatives of K, so it is symmetric
up to signs.  With H = Lᵀ D L along the tree, ∂²K/∂(μ, π)² is the sum over pivots of u u′/D.  The
column u of a momentum has entries only at its joint, at the ancestors and at the root.

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

from collections.abc import Sequence
from dataclasses import dataclass, field

from .articulated_body import Articulated, Step, angular_row, linear_row
from .articulated_sweep import Eliminated, Swept
from .body_frames import Body
from .identical_branches import Lanes, Link
from .scalars import Mat, Scalar, Vec, add, cross, dot, mul, plus, solve_lower, sub, total


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
