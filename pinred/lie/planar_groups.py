"""ℝ, SO(2) and SE(2): motions along a line, about an axis, and in a plane."""

from __future__ import annotations

import numpy as np

from ..common.arrays import Array
from .group import Group
from .rotations import apply, homogeneous, plane_rotation, sinc, wrap


class _Additive(Group):
    """A group with one coordinate; composition adds coordinates."""

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


class _SE2(Group):
    """SE(2): translations in a plane and rotations about its normal.

    Pose: (x, y, θ) [m, m, rad], θ unwrapped.  Twist: (v1, v2, ω) in the body frame
    [m/s, m/s, rad/s].  Momentum: (p1, p2, L) in the body frame, L about its origin
    [kg·m/s, kg·m/s, kg·m²/s].
    """

    def identity(self) -> Array:
        return np.zeros(3)

    def compose(self, g: Array, h: Array) -> Array:
        p = g[..., :2] + apply(plane_rotation(g[..., 2]), h[..., :2])
        return np.concatenate([p, g[..., 2:] + h[..., 2:]], axis=-1)

    def inverse(self, g: Array) -> Array:
        return np.concatenate(
            [-apply(plane_rotation(-g[..., 2]), g[..., :2]), -g[..., 2:]], axis=-1
        )

    def exp(self, xi: Array) -> Array:
        w = xi[..., 2:]
        a, b = sinc(w), 0.5 * w * sinc(0.5 * w) ** 2  # sin(ω)/ω and (1 − cos ω)/ω
        v1, v2 = xi[..., :1], xi[..., 1:2]
        return np.concatenate([a * v1 - b * v2, b * v1 + a * v2, w], axis=-1)

    def log(self, g: Array) -> Array:
        w = wrap(g[..., 2:])
        a, b = np.cos(0.5 * w) / sinc(0.5 * w), 0.5 * w
        x, y = g[..., :1], g[..., 1:2]
        return np.concatenate([a * x + b * y, a * y - b * x, w], axis=-1)

    def Ad(self, g: Array) -> Array:
        matrix = homogeneous(plane_rotation(g[..., 2]), g[..., :2])
        matrix[..., 0, 2], matrix[..., 1, 2] = g[..., 1], -g[..., 0]
        return matrix

    def ad(self, xi: Array) -> Array:
        matrix = np.zeros((*xi.shape[:-1], 3, 3))
        matrix[..., 0, 1], matrix[..., 1, 0] = -xi[..., 2], xi[..., 2]
        matrix[..., 0, 2], matrix[..., 1, 2] = xi[..., 1], -xi[..., 0]
        return matrix

    def rate(self, g: Array, xi: Array) -> Array:
        return np.concatenate([apply(plane_rotation(g[..., 2]), xi[..., :2]), xi[..., 2:]], axis=-1)

    def matrix(self, g: Array) -> Array:
        return homogeneous(plane_rotation(g[..., 2]), g[..., :2])

    def from_matrix(self, matrix: Array) -> Array:
        theta = np.arctan2(matrix[..., 1, :1], matrix[..., 0, :1])
        return np.concatenate([matrix[..., :2, 2], theta], axis=-1)


SE2 = _SE2(
    name="SE2",
    axes=(0, 1, 5),
    pose_names=("x", "y", "θ"),
    root="planar",
    joints=("Planar",),
    conserved="momentum in the plane and angular momentum about the centre of mass",
)
