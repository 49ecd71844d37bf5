"""SO(3): rotations about a fixed point."""

from __future__ import annotations

import numpy as np

from ..common.arrays import Array
from .group import Group
from .rotations import (
    conjugate,
    hat,
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
