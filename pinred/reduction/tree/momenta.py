"""Momenta of the bodies of a tree, the bracket of its group, its centre of mass."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from ...lie.group import Group
from ...system.system import System
from .all_joints import joint_rates, joint_values, on_shape
from .articulated_body import Articulated, Step, angular_row, carried, linear_row, rigid
from .articulated_sweep import step_of
from .body_frames import Body, bodies_of
from .scalars import INDEX, Scalar, Vec, add, cross, mul, plus, sub, times, total


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


def momenta(
    system: System,
    x: ca.SX,
    v: ca.SX,
    tensors: Sequence[Articulated] | None = None,
    *,
    bodies: list[Body] | None = None,
    rotors: bool = True,
) -> ca.SX:
    """Return the momenta H(x) v, (n,), of velocities v = (ξ, ẋ), in one sweep.

    tensors: of each body in its frame, root first, what stands in the place of its inertia (a
    drag, say).  bodies: with other inertias than the system's, if given.  rotors: whether joints
    have their armature.
    """
    group, r = system.group, system.r
    bodies = bodies_of(system) if bodies is None else bodies
    rates = joint_rates(system, [v[r + k] for k in range(system.m)])
    steps = steps_at(system, bodies, x)
    twists = twists_of(bodies, steps, in_space(group, v), rates)
    if tensors is None:
        held = [_momentum(body, *twist) for body, twist in zip(bodies, twists, strict=True)]
    else:
        held = [_push(tensor, *twist) for tensor, twist in zip(tensors, twists, strict=True)]
    pi: list[Scalar] = [0.0] * len(rates)
    for i in range(len(bodies) - 1, 0, -1):
        body, (lin, ang) = bodies[i], held[i]
        pi[i - 1] = (lin if body.prismatic else ang)[2]
        if rotors:
            pi[i - 1] = pi[i - 1] + body.armature * rates[i - 1]
        up, about = steps[i].inward(lin, ang)
        lin0, ang0 = held[body.parent]
        held[body.parent] = plus(lin0, up), plus(ang0, about)
    lin, ang = held[0]
    mu = [[*lin, *ang][axis] for axis in group.axes]
    if rotors:  # only about one axis
        mu[0] = add(mu[0], mul(float(system.model.armature[0]), v[0]))
    column: ca.SX = ca.vertcat(*mu, *on_shape(system, pi))
    return column


def locked(
    system: System,
    x: ca.SX,
    tensors: Sequence[Articulated] | None = None,
    *,
    rotors: bool = True,
) -> ca.SX:
    """Return the inertia with all joints frozen, (r, r), of bodies or of their `tensors`."""
    bodies, axes = bodies_of(system), system.group.axes
    steps = steps_at(system, bodies, x)
    whole = [rigid(body) for body in bodies] if tensors is None else list(tensors)
    for i in range(len(bodies) - 1, 0, -1):
        p, own = bodies[i].parent, carried(whole[i], steps[i])
        whole[p] = Articulated(
            [add(a, b) for a, b in zip(whole[p].M, own.M, strict=True)],
            [plus(a, b) for a, b in zip(whole[p].B, own.B, strict=True)],
            [add(a, b) for a, b in zip(whole[p].I, own.I, strict=True)],
            own.lin, own.ang,
        )  # fmt: skip
    root, out = whole[0], ca.SX(len(axes), len(axes))
    for a, i in enumerate(axes):
        for b, j in enumerate(axes):
            if i < 3 and j < 3:
                entry = root.M[INDEX[i][j]]
            elif i >= 3 and j >= 3:
                entry = root.I[INDEX[i - 3][j - 3]]
            else:
                entry = root.B[i - 3][j] if i >= 3 else root.B[j - 3][i]
            out[a, b] = entry
    if rotors:
        out[0, 0] += float(system.model.armature[0])
    return ca.densify(out)


def steps_at(system: System, bodies: Sequence[Body], x: ca.SX) -> list[Step]:
    """Return the steps from parent to body at a shape; the root has none, and a step in place."""
    joints = joint_values(system, [x[k] for k in range(system.m)])
    none = Step([], [0.0, 0.0, 0.0], 0.0)
    return [none, *(step_of(bodies[i], joints[i - 1]) for i in range(1, len(bodies)))]


def twists_of(
    bodies: Sequence[Body], steps: Sequence[Step], root: tuple[Vec, Vec], rates: Sequence[Scalar]
) -> list[tuple[Vec, Vec]]:
    """Return the twists of all bodies in their frames, of that of the root and the joint rates."""
    twists = [root]
    for i in range(1, len(bodies)):
        vi, wi = steps[i].outward(*twists[bodies[i].parent])
        part = vi if bodies[i].prismatic else wi
        part[2] = part[2] + rates[i - 1]
        twists.append((vi, wi))
    return twists


def _momentum(body: Body, v: Vec, w: Vec) -> tuple[Vec, Vec]:
    lin = [sub(mul(body.mass, a), b) for a, b in zip(v, cross(body.moment, w), strict=True)]
    return lin, plus(cross(body.moment, v), times(body.inertia, w))


def _push(tensor: Articulated, v: Vec, w: Vec) -> tuple[Vec, Vec]:
    """Return what a tensor makes of a twist: its force and moment, or momentum."""
    return (
        [linear_row(tensor, k, v, w) for k in range(3)],
        [angular_row(tensor, k, v, w) for k in range(3)],
    )


def bracket(group: Group, a: ca.SX, b: ca.SX) -> ca.SX:
    """Return [a, b] in the group's algebra, which is a part of se(3)."""
    (v, w), (dv, dw) = in_space(group, a), in_space(group, b)
    moved = [sub(p, q) for p, q in zip(cross(w, dv), cross(dw, v), strict=True)]
    both = [*moved, *cross(w, dw)]
    column: ca.SX = ca.vertcat(ca.SX(0, 1), *(both[axis] for axis in group.axes))
    return column


def in_space(group: Group, xi: ca.SX) -> tuple[Vec, Vec]:
    """Return a twist of the root, (r,), as one of space: linear, angular."""
    both: Vec = [0.0] * 6
    for k, axis in enumerate(group.axes):
        both[axis] = xi[k]
    return both[:3], both[3:]
