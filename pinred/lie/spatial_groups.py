"""SO(3) and SE(3): rotations about a fixed point, and motions of a rigid body in space."""

from __future__ import annotations

import numpy as np

from ..common.arrays import Array
from .group import Group
from .rotations import (
    apply,
    conjugate,
    hat,
    homogeneous,
    left_jacobian,
    left_jacobian_inverse,
    quaternion_exp,
    quaternion_from_matrix,
    quaternion_log,
    quaternion_product,
    rotation,
    unit,
)


class _SO3(Group):
    """SO(3): rotations about a fixed point of the base.

    Pose: unit quaternion (qx, qy, qz, qw) from body to fixed axes, real part last.
    Twist: angular velocity (ω1, ω2, ω3) in the body frame [rad/s].  Momentum: angular momentum
    about the fixed point, (3,) in the body frame [kg·m²/s].
    """

    def identity(self) -> Array:
        return np.array([0.0, 0.0, 0.0, 1.0])

    def compose(self, g: Array, h: Array) -> Array:
        return quaternion_product(g, h)

    def inverse(self, g: Array) -> Array:
        return conjugate(g)

    def exp(self, xi: Array) -> Array:
        return quaternion_exp(xi)

    def log(self, g: Array) -> Array:
        return quaternion_log(g)

    def Ad(self, g: Array) -> Array:
        return rotation(g)

    def ad(self, xi: Array) -> Array:
        return hat(xi)

    def rate(self, g: Array, xi: Array) -> Array:
        zero = np.zeros((*xi.shape[:-1], 1))
        return 0.5 * quaternion_product(g, np.concatenate([xi, zero], axis=-1))

    def matrix(self, g: Array) -> Array:
        return rotation(g)

    def from_matrix(self, matrix: Array) -> Array:
        return quaternion_from_matrix(matrix)

    def normalize(self, g: Array) -> Array:
        return unit(g)


SO3 = _SO3(
    name="SO3",
    axes=(3, 4, 5),
    pose_names=("qx", "qy", "qz", "qw"),
    root="spherical",
    joints=("Spherical",),
    conserved="angular momentum about the pivot",
)


class _SE3(Group):
    """SE(3): translations and rotations of space.

    Pose: (x, y, z, qx, qy, qz, qw), position [m] and unit quaternion from body to fixed axes,
    real part last.  Twist: (v, ω) in the body frame [m/s, rad/s].  Momentum: (p, L) in the body
    frame, L about its origin [kg·m/s, kg·m²/s].
    """

    def identity(self) -> Array:
        return np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])

    def compose(self, g: Array, h: Array) -> Array:
        p = g[..., :3] + apply(rotation(g[..., 3:]), h[..., :3])
        return np.concatenate([p, quaternion_product(g[..., 3:], h[..., 3:])], axis=-1)

    def inverse(self, g: Array) -> Array:
        q = conjugate(g[..., 3:])
        return np.concatenate([-apply(rotation(q), g[..., :3]), q], axis=-1)

    def exp(self, xi: Array) -> Array:
        w = xi[..., 3:]
        p = apply(left_jacobian(w), xi[..., :3])
        return np.concatenate([p, quaternion_exp(w)], axis=-1)

    def log(self, g: Array) -> Array:
        w = quaternion_log(g[..., 3:])
        return np.concatenate([apply(left_jacobian_inverse(w), g[..., :3]), w], axis=-1)

    def Ad(self, g: Array) -> Array:
        R = rotation(g[..., 3:])
        matrix = np.zeros((*g.shape[:-1], 6, 6))
        matrix[..., :3, :3] = matrix[..., 3:, 3:] = R
        matrix[..., :3, 3:] = hat(g[..., :3]) @ R
        return matrix

    def ad(self, xi: Array) -> Array:
        matrix = np.zeros((*xi.shape[:-1], 6, 6))
        matrix[..., :3, :3] = matrix[..., 3:, 3:] = hat(xi[..., 3:])
        matrix[..., :3, 3:] = hat(xi[..., :3])
        return matrix

    def rate(self, g: Array, xi: Array) -> Array:
        q = g[..., 3:]
        p = apply(rotation(q), xi[..., :3])
        return np.concatenate([p, SO3.rate(q, xi[..., 3:])], axis=-1)

    def matrix(self, g: Array) -> Array:
        return homogeneous(rotation(g[..., 3:]), g[..., :3])

    def from_matrix(self, matrix: Array) -> Array:
        return np.concatenate(
            [matrix[..., :3, 3], quaternion_from_matrix(matrix[..., :3, :3])], axis=-1
        )

    def normalize(self, g: Array) -> Array:
        return np.concatenate([g[..., :3], unit(g[..., 3:])], axis=-1)


SE3 = _SE3(
    name="SE3",
    axes=(0, 1, 2, 3, 4, 5),
    pose_names=("x", "y", "z", *SO3.pose_names),
    root="free flyer",
    joints=("FreeFlyer",),
    conserved="momentum and angular momentum about the centre of mass",
)
