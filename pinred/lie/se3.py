"""SE(3): motions of space."""

from __future__ import annotations

import numpy as np

from ..common.arrays import Array
from .group import Group
from .rotations import (
    apply,
    conjugate,
    hat,
    homogeneous,
    quaternion_exp,
    quaternion_log,
    quaternion_of,
    quaternion_product,
    rotation,
    turning_inverse,
    turning_matrix,
    unit,
)
from .so3 import SO3


class _SE3(Group):
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
        p = apply(turning_matrix(w), xi[..., :3])
        return np.concatenate([p, quaternion_exp(w)], axis=-1)

    def log(self, g: Array) -> Array:
        w = quaternion_log(g[..., 3:])
        return np.concatenate([apply(turning_inverse(w), g[..., :3]), w], axis=-1)

    def Ad(self, g: Array) -> Array:
        R = rotation(g[..., 3:])
        out = np.zeros((*g.shape[:-1], 6, 6))
        out[..., :3, :3] = out[..., 3:, 3:] = R
        out[..., :3, 3:] = hat(g[..., :3]) @ R
        return out

    def ad(self, xi: Array) -> Array:
        out = np.zeros((*xi.shape[:-1], 6, 6))
        out[..., :3, :3] = out[..., 3:, 3:] = hat(xi[..., 3:])
        out[..., :3, 3:] = hat(xi[..., :3])
        return out

    def rate(self, g: Array, xi: Array) -> Array:
        q = g[..., 3:]
        p = apply(rotation(q), xi[..., :3])
        return np.concatenate([p, SO3.rate(q, xi[..., 3:])], axis=-1)

    def matrix(self, g: Array) -> Array:
        return homogeneous(rotation(g[..., 3:]), g[..., :3])

    def from_matrix(self, matrix: Array) -> Array:
        return np.concatenate([matrix[..., :3, 3], quaternion_of(matrix[..., :3, :3])], axis=-1)

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
