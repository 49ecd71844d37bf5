"""ℝ and SO(2): one coordinate under addition."""

from __future__ import annotations

import numpy as np

from ..common.arrays import Array
from .group import Group
from .rotations import homogeneous, plane_rotation, wrap


class _Additive(Group):
    """One coordinate under addition."""

    def identity(self) -> Array:
        return np.zeros(1)

    def compose(self, g: Array, h: Array) -> Array:
        return g + h

    def inverse(self, g: Array) -> Array:
        return -g

    def exp(self, xi: Array) -> Array:
        return np.array(xi)

    def log(self, g: Array) -> Array:
        return np.array(g)

    def Ad(self, g: Array) -> Array:
        return np.ones((*g.shape[:-1], 1, 1))

    def ad(self, xi: Array) -> Array:
        return np.zeros((*xi.shape[:-1], 1, 1))

    def rate(self, g: Array, xi: Array) -> Array:  # noqa: ARG002
        return np.array(xi)


class _R(_Additive):
    def matrix(self, g: Array) -> Array:
        return homogeneous(np.ones((1, 1)), g)

    def from_matrix(self, matrix: Array) -> Array:
        return np.array(matrix[..., :1, 1])


class _SO2(_Additive):
    def log(self, g: Array) -> Array:
        return wrap(g)

    def matrix(self, g: Array) -> Array:
        return plane_rotation(g[..., 0])

    def from_matrix(self, matrix: Array) -> Array:
        return np.arctan2(matrix[..., 1, :1], matrix[..., 0, :1])


R = _R(
    name="R",
    axes=(2,),
    pose_names=("s",),
    root="prismatic",
    joints=("PX", "PY", "PZ", "PrismaticUnaligned"),
    conserved="momentum along the root's axis",
)

# "RUB" is Pinocchio's name for a revolute joint without limits: its coordinates are (cos, sin).
SO2 = _SO2(
    name="SO2",
    axes=(5,),
    pose_names=("θ",),
    root="revolute",
    joints=(
        *("RZ", "RX", "RY", "RevoluteUnaligned"),
        *("RUBX", "RUBY", "RUBZ", "RevoluteUnboundedUnaligned"),
    ),
    conserved="angular momentum about the root's axis",
)
