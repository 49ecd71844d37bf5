"""SE(3): rigid motions of space."""

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
from .so3 import SO3


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
