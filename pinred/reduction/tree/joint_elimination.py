"""Elimination of the rates of one joint from the articulated inertia of its subtree.

With the momentum U of the subtree per unit rate, and D its component along the rate, the rate is
(π − momentum of the rest)/D.  The remaining inertia is smaller by U Uᵀ/D.
"""

from __future__ import annotations

from dataclasses import dataclass

from .articulated_body import Articulated, Step, momentum_of_rate
from .body_frames import Freedom
from .coupled_groups import Groups
from .scalars import INDEX, Scalar, Vec, add, dot, mul, sub


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
