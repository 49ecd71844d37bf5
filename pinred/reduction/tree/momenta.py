"""Momenta of the bodies of a tree, the bracket of its group, its centre of mass."""

from __future__ import annotations

import casadi as ca

from ...system.system import System
from .articulated_sweep import step_of
from .body_frames import Body, bodies_of
from .scalars import Scalar, Vec, cross, mul, plus, sub, times, total

AXES: dict[str, list[tuple[bool, int]]] = {
    "R": [(False, 2)],
    "SO2": [(True, 2)],
    "SE2": [(False, 0), (False, 1), (True, 2)],
    "SO3": [(True, 0), (True, 1), (True, 2)],
    "SE3": [(False, 0), (False, 1), (False, 2), (True, 0), (True, 1), (True, 2)],
}


def centre_of_mass(bodies: list[Body], x: list[Scalar]) -> Vec:
    """Return the centre of mass in Pinocchio's root body frame, (3,)."""
    mass: list[float] = [body.mass for body in bodies]
    moment: list[Vec] = [[float(c) for c in body.moment] for body in bodies]
    for i in range(len(bodies) - 1, 0, -1):
        p, step = bodies[i].parent, step_of(bodies[i], x[i - 1])
        moved = plus(moment[i], [0.0, 0.0, mul(mass[i], step.slide)])
        for turn in reversed(step.turns):
            moved = turn.vector(moved)
        moved = plus(moved, [mul(mass[i], c) for c in step.shift])
        moment[p] = plus(moment[p], moved)
        mass[p] += mass[i]
    own = bodies[0].frame.rotation
    com = [mul(1.0 / mass[0], c) for c in moment[0]]
    return [total([mul(float(own[i, k]), com[k]) for k in range(3)]) for i in range(3)]


def momenta(system: System, x: ca.SX, v: ca.SX) -> ca.SX:
    """Return the momenta H(x) v, (n,), of velocities v = (ξ, ẋ), in one sweep."""
    bodies, axes = bodies_of(system), AXES[system.group.name]
    linear: Vec = [0.0, 0.0, 0.0]
    angular: Vec = [0.0, 0.0, 0.0]
    for k, (turning, axis) in enumerate(axes):
        (angular if turning else linear)[axis] = v[k]
    steps = [None, *(step_of(bodies[i], x[i - 1]) for i in range(1, len(bodies)))]
    twists = [(linear, angular)]
    for i in range(1, len(bodies)):
        step = steps[i]
        assert step is not None
        vi, wi = step.outward(*twists[bodies[i].parent])
        part = vi if bodies[i].prismatic else wi
        part[2] = part[2] + v[system.r + i - 1]
        twists.append((vi, wi))
    carried = [_momentum(body, *twist) for body, twist in zip(bodies, twists, strict=True)]
    pi: list[Scalar] = [0.0] * system.m
    for i in range(len(bodies) - 1, 0, -1):
        body, (lin, ang), step = bodies[i], carried[i], steps[i]
        assert step is not None
        pi[i - 1] = (lin if body.prismatic else ang)[2] + body.armature * v[system.r + i - 1]
        up, about = step.inward(lin, ang)
        lin0, ang0 = carried[body.parent]
        carried[body.parent] = plus(lin0, up), plus(ang0, about)
    lin, ang = carried[0]
    mu = [(ang if turning else lin)[axis] for turning, axis in axes]
    if system.group.name == "SO2":
        mu[0] = mu[0] + float(system.model.armature[0]) * v[0]
    column: ca.SX = ca.vertcat(*mu, *pi)
    return column


def _momentum(body: Body, v: Vec, w: Vec) -> tuple[Vec, Vec]:
    lin = [sub(mul(body.mass, a), b) for a, b in zip(v, cross(body.moment, w), strict=True)]
    return lin, plus(cross(body.moment, v), times(body.inertia, w))


def bracket(system: System, a: ca.SX, b: ca.SX) -> ca.SX:
    """Return [a, b] in the group's algebra."""
    name = system.group.name
    if name in ("R", "SO2"):
        return ca.SX.zeros(1)
    if name == "SO3":
        return ca.cross(a, b)
    if name == "SE2":
        return ca.vertcat(b[2] * a[1] - a[2] * b[1], a[2] * b[0] - b[2] * a[0], 0)
    return ca.vertcat(ca.cross(a[3:], b[:3]) - ca.cross(b[3:], a[:3]), ca.cross(a[3:], b[3:]))
