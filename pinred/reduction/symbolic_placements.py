"""Placements as CasADi expressions: a position and a quaternion, the real part last."""

from __future__ import annotations

from typing import TypeAlias

import casadi as ca
import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..system.assembly import link_frame
from ..system.joints import axes_of
from ..system.system import System
from .tree.all_joints import joint_values

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
