"""Rows of the Jacobian of closed loops, and their time derivatives along given multipliers.

The joints between the two frames of a loop are a chain from frame a to frame b.  In the axes of
frame a, with the axis z and the origin o of a joint, r = p_b − o, and the relative attitude R of
frame b, a rate σ q̇ of the chain (σ = −1 on the side of frame a) moves frame b by

    ṗ_b = σ q̇ z × r,   Ṙ = σ q̇ ẑ R,

so a row of J has entries σ z · m with m = r × f + Σ g_ik R e_k × e_i, where f are the coefficients
of p_b in the equation, and g_ik those of R_ik.  With multipliers as coefficients, Jᵀν has these
entries, and J̇ᵀν has

    σ z · (ṁ + m × ω),

where ω is the velocity relative to frame a of a body in which z is fixed.  A slide has σ z · f and
σ z · (f × ω).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ...system.loops.kinematics import LoopEnd, loop_ends, rotation_axes
from ...system.loops.loop import JointPolynomial, Loop
from ...system.shape_space import PlacedJoint, ShapeSpace
from .articulated_sweep import step_of
from .body_frames import Body
from .scalars import Mat, Scalar, Vec, add, cross, dot, mul, plus, sub

_UNITS: Mat = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


@dataclass
class _Crossing:
    """A joint of the chain, in the axes of frame a.

    Attributes:
        body: Body that the joint moves.
        sign: −1 on the side of frame a, else 1.
        axes: Axis of each rate.
        origin: Point on the axes.
        before: Displacement from the previous origin, (3,), fixed in the body before the joint.
        after: Displacement behind the joint, (3,), fixed in the body behind it.
    """

    body: Body
    sign: float
    axes: Mat
    origin: Vec
    before: Vec
    after: Vec


@dataclass
class LoopRows:
    """The chain of a loop at a shape.

    Attributes:
        loop: The loop.
        crossings: Joints from frame a to frame b.
        tip: Origin of frame b, (3,).
        last: Displacement from the last joint to it.
        attitude: Columns R e_k of the attitude of frame b.
    """

    loop: Loop
    crossings: list[_Crossing]
    tip: Vec
    last: Vec
    attitude: Mat

    @classmethod
    def at(
        cls, model: pin.Model, bodies: Sequence[Body], loop: Loop, joints: Sequence[Scalar]
    ) -> LoopRows:
        """Return the chain for values of all tree joints."""
        a, b = loop_ends(model, loop)
        chains = [chain_to_root(bodies, end) for end in (a, b)]
        common = set(chains[0]) & set(chains[1])
        up, down = ([i for i in chain if i not in common] for chain in chains)
        places = [bodies[end.joint - 1].frame.actInv(end.placement) for end in (a, b)]
        # The rows of R are e_i of frame a in the axes of the current body.
        rows: Mat = [[float(c) for c in row] for row in places[0].rotation.T]
        position: Vec = [-dot(row, [float(c) for c in places[0].translation]) for row in rows]
        pending, crossings = list(position), list[_Crossing]()
        for i in up:
            body, step = bodies[i], step_of(bodies[i], joints)
            axes = _axes(body, rows)
            for turn in reversed(step.turns):
                if not turn.is_none:
                    rows = [turn.vector(row) for row in rows]
            back = [mul(-1.0, dot(row, step.shift)) for row in rows]
            after = plus(back, [mul(-1.0, mul(z, step.slide)) for z in axes[0]])
            if body.is_ball:
                after = back
            crossings.append(_Crossing(body, -1.0, axes, position, pending, after))
            position, pending = plus(position, after), [0.0, 0.0, 0.0]
        for i in reversed(down):
            body, step = bodies[i], step_of(bodies[i], joints)
            before = plus(pending, [dot(row, step.shift) for row in rows])
            at = plus(position, [dot(row, step.shift) for row in rows])
            for turn in step.turns:
                if not turn.is_none:
                    rows = [turn.back(row) for row in rows]
            axes = _axes(body, rows)
            slide = [0.0] * 3 if body.is_ball else [mul(z, step.slide) for z in axes[0]]
            crossings.append(_Crossing(body, 1.0, axes, at, before, slide))
            position, pending = plus(at, slide), [0.0, 0.0, 0.0]
        last = plus(pending, [dot(row, [float(c) for c in places[1].translation]) for row in rows])
        tip = plus(position, [sub(c, p) for c, p in zip(last, pending, strict=True)])
        turned = [[float(c) for c in column] for column in places[1].rotation.T]
        attitude = [[dot(row, column) for row in rows] for column in turned]
        return cls(loop, crossings, tip, last, attitude)

    def row(self, n: int) -> dict[int, Scalar]:
        """Return row n of J: {tree rate: entry}."""
        f, turning = _coefficients(self.loop, {n: 1.0})
        entries: dict[int, Scalar] = {}
        for crossing, m in self._moments(f, turning):
            for k, axis in enumerate(crossing.axes):
                along = f if crossing.body.prismatic else m
                entries[crossing.body.v_at + k] = mul(crossing.sign, dot(axis, along))
        return entries

    def turning(self, nu: Mapping[int, Scalar], rates: Sequence[Scalar]) -> dict[int, Scalar]:
        """Return J̇ᵀν for multipliers {row: value} and rates of the tree: {tree rate: entry}."""
        f, turning = _coefficients(self.loop, nu)
        omega: Vec = [0.0, 0.0, 0.0]
        velocity: Vec = [0.0, 0.0, 0.0]
        spins: list[tuple[Vec, Vec]] = []
        for crossing in self.crossings:
            body = crossing.body
            velocity = plus(velocity, cross(omega, crossing.before))
            at, near = velocity, omega
            moved: Vec = [0.0, 0.0, 0.0]
            for k, axis in enumerate(crossing.axes):
                rate = mul(crossing.sign, rates[body.v_at + k])
                moved = plus(moved, [mul(rate, z) for z in axis])
            if body.prismatic:
                velocity = plus(velocity, moved)
            else:
                omega = plus(omega, moved)
            velocity = plus(velocity, cross(omega, crossing.after))
            # The axes of a ball are fixed in the body that it moves.
            fixed = omega if body.is_ball and crossing.sign > 0.0 else near
            spins.append((at, fixed))
        tip = plus(velocity, cross(omega, self.last))
        columns = {k: cross(omega, self.attitude[k]) for _, k in turning}
        rate_of_turn = _turn(turning, columns)
        entries: dict[int, Scalar] = {}
        for (crossing, m), (at, spin) in zip(self._moments(f, turning), spins, strict=True):
            if crossing.body.prismatic:
                load = cross(f, spin)
            else:
                arm = [sub(p, q) for p, q in zip(tip, at, strict=True)]
                load = plus(plus(cross(arm, f), rate_of_turn), cross(m, spin))
            for k, axis in enumerate(crossing.axes):
                entries[crossing.body.v_at + k] = mul(crossing.sign, dot(axis, load))
        return entries

    def _moments(
        self, f: Vec, turning: Mapping[tuple[int, int], Scalar]
    ) -> Iterator[tuple[_Crossing, Vec]]:
        """Yield each joint with its moment m."""
        turn = _turn(turning, dict(enumerate(self.attitude)))
        for crossing in self.crossings:
            arm = [sub(p, q) for p, q in zip(self.tip, crossing.origin, strict=True)]
            yield crossing, plus(cross(arm, f), turn)


@dataclass
class PolynomialRow:
    """The row of a polynomial between two joints."""

    tree: ShapeSpace
    law: JointPolynomial
    joints: Sequence[Scalar]

    def row(self, n: int) -> dict[int, Scalar]:  # noqa: ARG002
        """Return the row of J: {tree rate: entry}."""
        follower, leader = self._rates
        return {follower: 1.0, leader: mul(-1.0, self._polynomial(1))}

    def turning(self, nu: Mapping[int, Scalar], rates: Sequence[Scalar]) -> dict[int, Scalar]:
        """Return J̇ᵀν, as LoopRows.turning does."""
        leader = self._rates[1]
        return {leader: mul(-1.0, mul(mul(self._polynomial(2), rates[leader]), nu[0]))}

    @property
    def _rates(self) -> tuple[int, int]:
        names = self.law.follower, self.law.leader
        follower, leader = (self._joint(name).v.start for name in names)
        return follower, leader

    def _joint(self, name: str) -> PlacedJoint:
        return next(joint for joint in self.tree.joints if joint.name == name)

    def _polynomial(self, derivative: int) -> Scalar:
        """Return a derivative of the polynomial at the leader, by Horner's rule."""
        leader = sub(self.joints[self._joint(self.law.leader).x.start], self.law.leader_zero)
        coefficients = np.polynomial.polynomial.polyder(self.law.coefficients, derivative)
        value: Scalar = 0.0
        for c in reversed(coefficients.tolist()):
            value = add(mul(value, leader), c)
        return value


def chain_to_root(bodies: Sequence[Body], end: LoopEnd) -> list[int]:
    """Return the bodies from the body of a frame to the root."""
    chain = [end.joint - 1]
    while chain[-1]:
        chain.append(bodies[chain[-1]].parent)
    return chain


def _axes(body: Body, rows: Mat) -> Mat:
    """Return the axes of a joint's rates; rows: axes of frame a in the axes of its body."""
    if not body.is_ball:
        return [[row[2] for row in rows]]
    return [[dot(row, body.to_frame(unit)) for row in rows] for unit in _UNITS]


def _turn(turning: Mapping[tuple[int, int], Scalar], columns: Mapping[int, Vec]) -> Vec:
    """Return Σ g_ik R e_k × e_i."""
    total: Vec = [0.0, 0.0, 0.0]
    for (i, k), g in turning.items():
        total = plus(total, [mul(g, c) for c in cross(columns[k], _UNITS[i])])
    return total


def _coefficients(
    loop: Loop, nu: Mapping[int, Scalar]
) -> tuple[Vec, dict[tuple[int, int], Scalar]]:
    """Return the coefficients f of the position and g_ik of the attitude for multipliers."""
    f: Vec = [nu.get(n, 0.0) for n in range(3)]
    turning: dict[tuple[int, int], Scalar] = {}
    for n, value in nu.items():
        if n < 3:
            continue
        if loop.kind == "6d":
            i, k = ((2, 1), (0, 2), (1, 0))[n - 3]
            for pair, sign in (((i, k), 0.5), ((k, i), -0.5)):
                turning[pair] = add(turning.get(pair, 0.0), mul(sign, value))
        else:
            turning[rotation_axes(loop.kind)[n - 3]] = value
    return f, turning
