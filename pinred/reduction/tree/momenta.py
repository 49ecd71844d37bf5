"""Momenta of the bodies of a tree, the bracket of its group, its centre of mass."""

from __future__ import annotations

import casadi as ca

from ...system.system import System
from .all_joints import joint_rates, joint_values, on_shape
from .articulated_sweep import step_of
from .body_frames import Body, bodies_of
from .scalars import Scalar, Vec, add, cross, mul, plus, sub, times, total


def centre_of_mass(bodies: list[Body], x: list[Scalar]) -> Vec:
    """Return the centre of mass in Pinocchio's root body frame, (3,).

    x: of all joints of the tree.
    """
    mass: list[Scalar] = [body.mass for body in bodies]
    moment: list[Vec] = [list(body.moment) for body in bodies]
    for i in range(len(bodies) - 1, 0, -1):
        p, step = bodies[i].parent, step_of(bodies[i], x[i - 1])
        moved = plus(moment[i], [0.0, 0.0, mul(mass[i], step.slide)])
        for turn in reversed(step.turns):
            moved = turn.vector(moved)
        moved = plus(moved, [mul(mass[i], c) for c in step.shift])
        moment[p] = plus(moment[p], moved)
        mass[p] = add(mass[p], mass[i])
    own = bodies[0].frame.rotation
    com = [mul(1.0 / mass[0], c) for c in moment[0]]
    return [total([mul(float(own[i, k]), com[k]) for k in range(3)]) for i in range(3)]


def momenta(system: System, x: ca.SX, v: ca.SX, bodies: list[Body] | None = None) -> ca.SX:
    """Return the momenta H(x) v, (n,), of velocities v = (ξ, ẋ), in one sweep.

    bodies: with other inertias than the system's, if given.
    """
    r = system.r
    bodies = bodies_of(system) if bodies is None else bodies
    joints = joint_values(system, [x[k] for k in range(system.m)])
    rates = joint_rates(system, [v[r + k] for k in range(system.m)])
    steps = [None, *(step_of(bodies[i], joints[i - 1]) for i in range(1, len(bodies)))]
    twists = [_in_space(system, v)]
    for i in range(1, len(bodies)):
        step = steps[i]
        assert step is not None
        vi, wi = step.outward(*twists[bodies[i].parent])
        part = vi if bodies[i].prismatic else wi
        part[2] = part[2] + rates[i - 1]
        twists.append((vi, wi))
    carried = [_momentum(body, *twist) for body, twist in zip(bodies, twists, strict=True)]
    pi: list[Scalar] = [0.0] * len(rates)
    for i in range(len(bodies) - 1, 0, -1):
        body, (lin, ang), step = bodies[i], carried[i], steps[i]
        assert step is not None
        pi[i - 1] = (lin if body.prismatic else ang)[2] + body.armature * rates[i - 1]
        up, about = step.inward(lin, ang)
        lin0, ang0 = carried[body.parent]
        carried[body.parent] = plus(lin0, up), plus(ang0, about)
    lin, ang = carried[0]
    mu = [[*lin, *ang][axis] for axis in system.group.axes]
    mu[0] = add(mu[0], mul(float(system.model.armature[0]), v[0]))  # only about one axis
    column: ca.SX = ca.vertcat(*mu, *on_shape(system, pi))
    return column


def _momentum(body: Body, v: Vec, w: Vec) -> tuple[Vec, Vec]:
    lin = [sub(mul(body.mass, a), b) for a, b in zip(v, cross(body.moment, w), strict=True)]
    return lin, plus(cross(body.moment, v), times(body.inertia, w))


def bracket(system: System, a: ca.SX, b: ca.SX) -> ca.SX:
    """Return [a, b] in the group's algebra, which is a part of se(3)."""
    (v, w), (dv, dw) = _in_space(system, a), _in_space(system, b)
    moved = [sub(p, q) for p, q in zip(cross(w, dv), cross(dw, v), strict=True)]
    both = [*moved, *cross(w, dw)]
    column: ca.SX = ca.vertcat(ca.SX(0, 1), *(both[axis] for axis in system.group.axes))
    return column


def _in_space(system: System, xi: ca.SX) -> tuple[Vec, Vec]:
    """Return a twist of the root, (r,), as one of space: linear, angular."""
    both: Vec = [0.0] * 6
    for k, axis in enumerate(system.group.axes):
        both[axis] = xi[k]
    return both[:3], both[3:]
