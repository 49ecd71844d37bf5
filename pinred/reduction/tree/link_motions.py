"""Tensors, points and frames fixed to bodies, transformed to the body frames of the sweep."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...system.system import System
from .all_joints import joint_rates
from .articulated_body import Articulated
from .body_frames import Body, bodies_of
from .momenta import in_space, steps_at, twists_of
from .scalars import Vec, add, cross, dot, plus, sub


def tensors_of(system: System, tensors: Sequence[Array]) -> list[Articulated]:
    """Return the tensors of all bodies in the body frames of the sweep, root first.

    tensors: symmetric, (6, 6), each in the joint frame of its body.
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
    model = system.model
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
        twist: Its twist in its frame.
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
        x: Shape symbols, (m,).
        number: Index of the body, 0 for the root.
        placement: Placement of the frame in the body's joint frame.
        xi: Body twist of the frame, (r,); all its motions are in the group.
        xdot: Shape rate, (m,).
    Returns:
        (r,).
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
    """Transform a twist (v, w) to the frame in which its frame has the given placement."""
    R = [[float(c) for c in row] for row in placement.rotation]
    p: Vec = [float(c) for c in placement.translation]
    v, w = [dot(row, v) for row in R], [dot(row, w) for row in R]
    return [add(a, b) for a, b in zip(v, cross(p, w), strict=True)], w
