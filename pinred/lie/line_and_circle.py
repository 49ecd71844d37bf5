"""ℝ and SO(2): groups with one coordinate, composed by addition."""

from __future__ import annotations

import numpy as np

from ..common.arrays import Array
from .group import Group
from .rotations import homogeneous, plane_rotation, wrap


class _Additive(Group):
    """A group with one coordinate, composed by addition."""

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
    """ℝ: translations along one axis.

    Pose: displacement (s,) [m].  Twist: speed (v,) [m/s].  Momentum: linear momentum along the
    axis, (1,) [kg·m/s].  The group is commutative, so body and spatial quantities are equal.
    """

    def matrix(self, g: Array) -> Array:
        return homogeneous(np.ones((1, 1)), g)

    def from_matrix(self, matrix: Array) -> Array:
        return np.array(matrix[..., :1, 1])


class _SO2(_Additive):
    """SO(2): rotations about one fixed axis.

    Pose: unwrapped angle (θ,) [rad].  Twist: angular rate (ω,) [rad/s].  Momentum: angular
    momentum about the axis, (1,) [kg·m²/s].  The group is commutative, so body and spatial
    quantities are equal.
    """

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

# "RUB" is Pinocchio's revolute joint without limits, whose coordinates are (cos, sin).
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
