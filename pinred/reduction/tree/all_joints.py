"""All joints of the tree at a shape: values, rates and placements, and momenta mapped back.

The tree has more joints than the shape if some joints follow others, x = G y + b (see coupling.py).
A placement is a position and a quaternion, the real part last.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import casadi as ca
import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...system.assembly import link_frame
from ...system.joints import axes_of
from ...system.system import System
from .scalars import Scalar, add, mul


def joint_values(system: System, x: Sequence[Scalar]) -> list[Scalar]:
    """Return the coordinates of all joints at shape x (nx,)."""
    coupled = system.coupled
    if coupled is None:
        return list(x)
    return [
        add(_sum(coupled.value_terms(j), x), offset)
        for j, offset in enumerate(coupled.offset.tolist())
    ]


def joint_rates(system: System, xdot: Sequence[Scalar]) -> list[Scalar]:
    """Return the rates of all joints at shape rate ẋ (m,)."""
    coupled = system.coupled
    if coupled is None:
        return list(xdot)
    return [_sum(coupled.terms(j), xdot) for j in range(len(coupled.G))]


def configuration(system: System, pose: Sequence[Scalar], x: Sequence[Scalar]) -> list[Scalar]:
    """Return Pinocchio's configuration, (nq,), at a pose and a shape x, (nx,)."""
    y, q = [*pose, *joint_values(system, x)], [0.0] * system.model.nq
    for i, at in system.plain:
        q[at] = y[i]
    for i, at in system.angles:
        q[at], q[at + 1] = ca.cos(y[i]), ca.sin(y[i])
    return q


def on_shape(system: System, momenta: Sequence[Scalar]) -> list[Scalar]:
    """Map momenta or forces p of all joints to shape momenta or forces Gᵀ p, (m,)."""
    coupled = system.coupled
    if coupled is None:
        return list(momenta)
    sums: list[Scalar] = [0.0] * system.m
    for j, value in enumerate(momenta):
        for k, ratio in coupled.terms(j):
            sums[k] = add(sums[k], mul(ratio, value))
    return sums


def shape_gradient(system: System, energy: ca.SX, x: ca.SX) -> ca.SX:
    """Return the derivatives e_αV, (m,), of an energy along the frame of the shape.

    The derivative along a ball's axes is E(q)ᵀ ∂V/∂q.  It is exact for every V, because E(q) is
    tangent to the sphere |q| = 1.

    Args:
        system: The system.
        energy: Energy V, an expression of x.
        x: Shape symbols, (nx,).
    Returns:
        The derivatives.
    """
    gradient = ca.gradient(energy, x)
    if not system.space.balls:
        return gradient
    entries: list[ca.SX] = []
    for joint in system.space.joints:
        slope = gradient[joint.x]
        entries.append(_along_axes(x[joint.x], slope) if joint.kind.is_ball else slope)
    column: ca.SX = ca.vertcat(*entries)
    return column


def rate_map(system: System, x: ca.SX) -> ca.SX:
    """Return E(x), (nx, m), which maps rates along the frame of the shape to derivatives of x."""
    space = system.space
    E = ca.SX(space.nx, space.m)
    for joint in space.joints:
        E[joint.x, joint.v] = _ball_rate_map(x[joint.x]) if joint.kind.is_ball else 1.0
    return E


def frame_jacobian(system: System, values: ca.SX, x: ca.SX) -> ca.SX:
    """Return the derivatives e_α, (k, m), of values (k,) along the frame of the shape."""
    jacobian: ca.SX = ca.jacobian(values, x)
    return jacobian @ rate_map(system, x) if system.space.balls else jacobian


def _ball_rate_map(q: ca.SX) -> ca.SX:
    """Return E, (4, 3), with q̇ = ½ q ∘ (σ, 0) = E σ."""
    matrix = ca.skew(q[:3]) + q[3] * ca.SX.eye(3)
    E: ca.SX = 0.5 * ca.vertcat(matrix, -q[:3].T)
    return E


def _along_axes(q: ca.SX, slope: ca.SX) -> ca.SX:
    """Return ½ Im(q̄ ∘ slope), (3,): the derivatives of a function of q along the child's axes."""
    u, w, v, s = q[:3], q[3], slope[:3], slope[3]
    column: ca.SX = 0.5 * (w * v - s * u - ca.cross(u, v))
    return column


def _sum(terms: list[tuple[int, float]], numbers: Sequence[Scalar]) -> Scalar:
    """Return the sum of ratios times numbers of the shape."""
    total: Scalar = 0.0
    for k, ratio in terms:
        total = add(total, mul(ratio, numbers[k]))
    return total


Placement: TypeAlias = tuple[ca.SX, ca.SX]


def all_joint_values(system: System, x: ca.SX) -> list[ca.SX]:
    """Return the coordinates of all joints of the tree at shape x (nx,)."""
    return [ca.SX(value) for value in joint_values(system, ca.vertsplit(x))]


def joint_frames(system: System, values: list[ca.SX]) -> list[Placement]:
    """Return the placements of all joints relative to the root body, by Pinocchio's index.

    Args:
        system: The system.
        values: Coordinates of all joints of the tree.
    Returns:
        The placements; those of the world and of the root are the identity.
    """
    model = system.sorted_model
    frames: list[Placement] = [(ca.SX.zeros(3), ca.SX([0, 0, 0, 1]))] * 2
    for i, joint in enumerate(system.tree.joints, start=2):
        S = axes_of(model.joints[i])
        coordinates = values[joint.x.start : joint.x.stop]
        shift, turn = ca.SX.zeros(3), ca.SX([0, 0, 0, 1])
        if joint.kind.is_ball:
            turn = ca.vertcat(*coordinates)
        elif joint.kind.units == ("m",):
            shift = ca.SX(S[:3, 0]) * coordinates[0]
        else:
            turn = ca.vertcat(
                ca.SX(S[3:, 0]) * ca.sin(coordinates[0] / 2), ca.cos(coordinates[0] / 2)
            )
        fixed = fixed_placement(model.jointPlacements[i])
        frames.append(compose(compose(frames[model.parents[i]], fixed), (shift, turn)))
    return frames


def fixed_placement(placement: pin.SE3) -> Placement:
    """Return a constant placement."""
    numbers = pin.SE3ToXYZQUAT(placement)
    return ca.SX(numbers[:3]), ca.SX(numbers[3:])


def compose(a: Placement, b: Placement) -> Placement:
    """Return the product of two placements."""
    (p, q), (shift, turn) = a, b
    u, s, v, t = q[:3], q[3], turn[:3], turn[3]
    product = ca.vertcat(s * v + t * u + ca.cross(u, v), s * t - ca.dot(u, v))
    return p + rotate(q, shift), product


def inverse(a: Placement) -> Placement:
    """Return the inverse of a placement."""
    p, q = a
    back = ca.vertcat(-q[:3], q[3])
    return -rotate(back, p), back


def rotate(q: ca.SX, v: ca.SX) -> ca.SX:
    """Rotate a vector by a quaternion."""
    across = 2.0 * ca.cross(q[:3], v)
    return v + q[3] * across + ca.cross(q[:3], across)


def height(system: System, pose: ca.SX, x: ca.SX, link: str) -> ca.SX:
    """Return the height of the origin of a link or frame above the world's origin [m].

    Heights are against gravity; without gravity, along z of the world.

    Args:
        system: The system.
        pose: Pose of the base, (size,).
        x: Shape, (nx,).
        link: Name of the link or frame.
    """
    model, group = system.sorted_model, system.group
    frame = model.frames[link_frame(system, link, "height")]
    S, k = axes_of(model.joints[1]), group.linear
    entries = [ca.SX(entry) for entry in ca.vertsplit(pose)]
    shift, turn = ca.SX.zeros(3), ca.SX([0, 0, 0, 1])
    for axis in range(k):
        shift += ca.SX(S[:3, axis]) * entries[axis]
    if group.turns == 3:
        turn = ca.vertcat(*entries[k:])
    elif group.turns == 1:
        turn = ca.vertcat(ca.SX(S[3:, k]) * ca.sin(entries[k] / 2), ca.cos(entries[k] / 2))
    base = compose(fixed_placement(model.jointPlacements[1]), (shift, turn))
    joints = joint_frames(system, all_joint_values(system, x))
    on_joint = fixed_placement(frame.placement)
    position, _ = compose(compose(base, joints[frame.parentJoint]), on_joint)
    return ca.dot(ca.SX(up_of(system)), position)


def up_of(system: System) -> Array:
    """Return the unit vector against gravity in the world, (3,); z without gravity."""
    gravity = system.gravity
    size = float(np.linalg.norm(gravity))
    return -gravity / size if size else np.array([0.0, 0.0, 1.0])
