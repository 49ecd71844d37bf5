"""CasADi expressions of a tree: momenta, mass matrix, locked inertia, centre of mass, curvature.

Tensors, points and frames fixed to bodies are transformed to the body frames of the sweep.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...lie.group import Group
from ...system.system import System
from .all_joints import frame_jacobian, joint_rates, joint_values, on_shape
from .articulated_sweep import step_of
from .body_frames import (
    Articulated,
    Body,
    Step,
    angular_row,
    bodies_of,
    carried,
    linear_row,
    moved_twist,
    rigid,
)
from .scalars import INDEX, Scalar, Vec, add, cross, dot, mul, plus, solve_spd, sub, times, total


def centre_of_mass(bodies: list[Body], x: list[Scalar]) -> Vec:
    """Return the centre of mass in Pinocchio's root body frame, (3,).

    x: coordinates of all tree joints.
    """
    mass: list[Scalar] = [body.mass for body in bodies]
    moment: list[Vec] = [list(body.moment) for body in bodies]
    for i in range(len(bodies) - 1, 0, -1):
        p, step = bodies[i].parent, step_of(bodies[i], x)
        first = plus(moment[i], [0.0, 0.0, mul(mass[i], step.slide)])
        for turn in reversed(step.turns):
            first = turn.vector(first)
        first = plus(first, [mul(mass[i], c) for c in step.shift])
        moment[p] = plus(moment[p], first)
        mass[p] = add(mass[p], mass[i])
    R = bodies[0].frame.rotation
    com = [mul(1.0 / mass[0], c) for c in moment[0]]
    return [total([mul(float(R[i, k]), com[k]) for k in range(3)]) for i in range(3)]


def momenta(
    system: System,
    x: ca.SX,
    v: ca.SX,
    tensors: Sequence[Articulated] | None = None,
    *,
    bodies: list[Body] | None = None,
    rotors: bool = True,
) -> ca.SX:
    """Return the momenta H(x) v, (n,), from one sweep over the tree.

    Args:
        system: The system.
        x: Shape symbols, (nx,).
        v: Velocity symbols (ξ, ẋ), (n,).
        tensors: Tensors that replace the inertias, such as drag, each in its body's frame, root
            first.
        bodies: Bodies that replace the system's bodies, with other inertias; None: the system's.
        rotors: Whether joints have armature.
    Returns:
        Momenta (μ, π), (n,).
    """
    group, r = system.group, system.r
    bodies = bodies_of(system) if bodies is None else bodies
    rates = joint_rates(system, [v[r + k] for k in range(system.m)])
    steps = steps_at(system, bodies, x)
    twists = twists_of(bodies, steps, in_space(group, v), rates)
    if tensors is None:
        wrenches = [_momentum(body, *twist) for body, twist in zip(bodies, twists, strict=True)]
    else:
        wrenches = [_apply(tensor, *twist) for tensor, twist in zip(tensors, twists, strict=True)]
    pi: list[Scalar] = [0.0] * len(rates)
    for i in range(len(bodies) - 1, 0, -1):
        body, (lin, ang) = bodies[i], wrenches[i]
        components = body.to_joint(ang) if body.is_ball else [(lin if body.prismatic else ang)[2]]
        for k, momentum in enumerate(components, start=body.v_at):
            pi[k] = momentum + body.armature * rates[k] if rotors else momentum
        up, about = steps[i].inward(lin, ang)
        lin0, ang0 = wrenches[body.parent]
        wrenches[body.parent] = plus(lin0, up), plus(ang0, about)
    lin, ang = wrenches[0]
    mu = [[*lin, *ang][axis] for axis in group.axes]
    if rotors:  # among root joints, only a joint with one axis has armature
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
    """Return the inertia with locked joints, (r, r).

    Args:
        system: The system.
        x: Shape symbols, (nx,).
        tensors: Tensors that replace the inertias, see `momenta`.
        rotors: Whether joints have armature.
    Returns:
        The locked inertia, or the same sum of the tensors.
    """
    bodies, axes = bodies_of(system), system.group.axes
    steps = steps_at(system, bodies, x)
    subtrees = [rigid(body) for body in bodies] if tensors is None else list(tensors)
    for i in range(len(bodies) - 1, 0, -1):
        p, child = bodies[i].parent, carried(subtrees[i], steps[i])
        subtrees[p] = Articulated(
            [add(a, b) for a, b in zip(subtrees[p].M, child.M, strict=True)],
            [plus(a, b) for a, b in zip(subtrees[p].B, child.B, strict=True)],
            [add(a, b) for a, b in zip(subtrees[p].I, child.I, strict=True)],
            child.lin, child.ang,
        )  # fmt: skip
    root, inertia = subtrees[0], ca.SX(len(axes), len(axes))
    for a, i in enumerate(axes):
        for b, j in enumerate(axes):
            if i < 3 and j < 3:
                entry = root.M[INDEX[i][j]]
            elif i >= 3 and j >= 3:
                entry = root.I[INDEX[i - 3][j - 3]]
            else:
                entry = root.B[i - 3][j] if i >= 3 else root.B[j - 3][i]
            inertia[a, b] = entry
    if rotors:
        inertia[0, 0] += float(system.model.armature[0])
    return ca.densify(inertia)


def steps_at(system: System, bodies: Sequence[Body], x: ca.SX) -> list[Step]:
    """Return each body's step from its parent at shape x (nx,); the root has the identity."""
    joints = joint_values(system, [x[k] for k in range(system.nx)])
    identity = Step([], [0.0, 0.0, 0.0], 0.0)
    return [identity, *(step_of(body, joints) for body in bodies[1:])]


def twists_of(
    bodies: Sequence[Body], steps: Sequence[Step], root: tuple[Vec, Vec], rates: Sequence[Scalar]
) -> list[tuple[Vec, Vec]]:
    """Return the twists of all bodies in their frames.

    Args:
        bodies: Bodies of the tree, root first.
        steps: Steps of the bodies from their parents.
        root: Twist of the root body, linear and angular.
        rates: Rates of all tree joints.
    Returns:
        Linear and angular velocity of each body.
    """
    twists = [root]
    for i in range(1, len(bodies)):
        vi, wi = steps[i].outward(*twists[bodies[i].parent])
        twists.append(moved_twist(bodies[i], vi, wi, rates))
    return twists


def _momentum(body: Body, v: Vec, w: Vec) -> tuple[Vec, Vec]:
    lin = [sub(mul(body.mass, a), b) for a, b in zip(v, cross(body.moment, w), strict=True)]
    return lin, plus(cross(body.moment, v), times(body.inertia, w))


def _apply(tensor: Articulated, v: Vec, w: Vec) -> tuple[Vec, Vec]:
    """Return a tensor times a twist: force and moment of drag, or momentum of an inertia."""
    return (
        [linear_row(tensor, k, v, w) for k in range(3)],
        [angular_row(tensor, k, v, w) for k in range(3)],
    )


def bracket(group: Group, a: ca.SX, b: ca.SX) -> ca.SX:
    """Return the Lie bracket [a, b] in the group's algebra, a subalgebra of se(3)."""
    (v, w), (dv, dw) = in_space(group, a), in_space(group, b)
    linear = [sub(p, q) for p, q in zip(cross(w, dv), cross(dw, v), strict=True)]
    twist = [*linear, *cross(w, dw)]
    column: ca.SX = ca.vertcat(ca.SX(0, 1), *(twist[axis] for axis in group.axes))
    return column


def in_space(group: Group, xi: ca.SX) -> tuple[Vec, Vec]:
    """Return a twist of the group, (r,), as linear and angular velocity in space."""
    twist: Vec = [0.0] * 6
    for k, axis in enumerate(group.axes):
        twist[axis] = xi[k]
    return twist[:3], twist[3:]


def tensors_of(system: System, tensors: Sequence[Array]) -> list[Articulated]:
    """Return the tensors of all bodies in the body frames of the sweep, root first.

    tensors: symmetric tensors (6, 6), each in the joint frame of its body.
    """
    transformed = []
    for body, tensor in zip(bodies_of(system), tensors, strict=True):
        X = body.frame.toActionMatrix()
        D = X.T @ tensor @ X
        D = np.where(np.abs(D) <= 4e-16 * np.abs(D).max(initial=0.0), 0.0, 0.5 * (D + D.T))
        none = [0.0, 0.0, 0.0]
        upper = [(i, j) for i in range(3) for j in range(i, 3)]
        transformed.append(
            Articulated(
                M=[float(D[i, j]) for i, j in upper],
                B=[[float(D[3 + i, j]) for j in range(3)] for i in range(3)],
                I=[float(D[3 + i, 3 + j]) for i, j in upper],
                lin=none,
                ang=none,
            )
        )
    return transformed


def inertia_tensors(system: System) -> list[Array]:
    """Return the inertias of all bodies, (6, 6) in their joint frames, root first."""
    model = system.sorted_model
    return [np.array(model.inertias[i].matrix()) for i in range(1, model.njoints)]


def twists_at(system: System, x: ca.SX, v: ca.SX) -> list[tuple[Vec, Vec]]:
    """Return the twists of all bodies in their frames for v = (ξ, ẋ), root first."""
    bodies, r = bodies_of(system), system.r
    rates = joint_rates(system, [v[r + k] for k in range(system.m)])
    return twists_of(bodies, steps_at(system, bodies, x), in_space(system.group, v), rates)


def speed_along(body: Body, twist: tuple[Vec, Vec], direction: Array, point: Array) -> ca.SX:
    """Return the speed of a point of a body along a direction.

    Args:
        body: The body.
        twist: Twist of the body in the body's frame.
        direction: Direction, (3,), in the joint frame of the body.
        point: Point, (3,) [m], in the joint frame of the body.
    Returns:
        The speed [m/s].
    """
    d: Vec = [float(c) for c in body.frame.rotation.T @ direction]
    p: Vec = [float(c) for c in body.frame.actInv(point)]
    speed: ca.SX = dot(d, plus(twist[0], cross(twist[1], p)))
    return speed


def root_twist(
    system: System, x: ca.SX, number: int, placement: pin.SE3, xi: ca.SX, xdot: ca.SX
) -> ca.SX:
    """Return the root's body twist, (r,), from the twist of a frame on another body.

    Args:
        system: The system.
        x: Shape symbols, (nx,).
        number: Index of the body, 0 for the root.
        placement: Placement of the frame in the body's joint frame.
        xi: Body twist of the frame, (r,); all motions of the frame are in the group.
        xdot: Shape rate, (m,).
    Returns:
        Body twist of the root, (r,).
    """
    bodies, r = bodies_of(system), system.r
    steps = steps_at(system, bodies, x)
    zero = ca.SX.zeros(r, 1)
    v, w = in_space(system.group, xi)
    v, w = _to_outer_frame(bodies[number].frame.actInv(placement), v, w)
    dv, dw = twists_at(system, x, ca.vertcat(zero, xdot))[number]
    v, w = [sub(a, b) for a, b in zip(v, dv, strict=True)], [
        sub(a, b) for a, b in zip(w, dw, strict=True)
    ]  # fmt: skip
    while number:
        # A twist transforms inward like a momentum with linear and angular parts swapped.
        w, v = steps[number].inward(w, v)
        number = bodies[number].parent
    both = [*v, *w]
    column: ca.SX = ca.vertcat(ca.SX(0, 1), *(both[axis] for axis in system.group.axes))
    return column


def _to_outer_frame(placement: pin.SE3, v: Vec, w: Vec) -> tuple[Vec, Vec]:
    """Transform a twist (v, w) from a frame to the outer frame in which `placement` places it."""
    R = [[float(c) for c in row] for row in placement.rotation]
    p: Vec = [float(c) for c in placement.translation]
    v, w = [dot(row, v) for row in R], [dot(row, w) for row in R]
    return [add(a, b) for a, b in zip(v, cross(p, w), strict=True)], w


@dataclass(frozen=True)
class CasadiReduction:
    """CasADi expressions of the terms of the reduction.

    They hold where the quaternions of balls have length one.

    Attributes:
        x: Shape symbols, (nx, 1).
        H: Mass matrix, (n, n).
        I: Locked inertia, (r, r).
        A: Local connection, (r, m).
        M: Reduced metric, (m, m).
        B: Curvature, (r, m²); column α m + β is B_αβ.
    """

    x: ca.SX
    H: ca.SX
    I: ca.SX
    A: ca.SX
    M: ca.SX
    B: ca.SX


def casadi_reduction(system: System, x: ca.SX | None = None) -> CasadiReduction:
    """Return the expressions of a system at shape symbols x (nx, 1); None: new symbols."""
    r = system.r
    x, v = ca.SX.sym("x", system.nx) if x is None else x, ca.SX.sym("v", system.n)
    H = ca.jacobian(momenta(system, x, v), v)
    I, Hbs, Hss = H[:r, :r], H[:r, r:], H[r:, r:]
    A = solve_spd(I, Hbs)
    return CasadiReduction(x, H, I, A, Hss - Hbs.T @ A, _curvature(system, x, A))


def _curvature(system: System, x: ca.SX, A: ca.SX) -> ca.SX:
    """Return the curvature; see reduction/pointwise_reduction.py."""
    r, m = system.r, system.m
    if not m:
        return ca.SX(r, 0)
    dA = [frame_jacobian(system, A[:, b], x) for b in range(m)]  # dA[β][:, α] = ∂_α A_β
    columns = [
        dA[b][:, a] - dA[a][:, b] - bracket(system.group, A[:, a], A[:, b])
        for a in range(m)
        for b in range(m)
    ]
    B: ca.SX = ca.horzcat(*columns)
    if not system.space.balls:
        return B
    # Column α m + β of c is c^γ_αβ, γ first.
    return B - A @ ca.SX(ca.DM(system.space.structure.reshape(m, m * m)))
