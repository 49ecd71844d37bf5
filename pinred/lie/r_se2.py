"""ℝ × SE(2): planar motions with a translation along the normal (Schoenflies motions).

Bodies that stay upright have this group: for example a heaving ship, a drone or blimp without roll
and pitch, a crane load, or the hand of a SCARA robot.
"""

from __future__ import annotations

import numpy as np

from ..common.arrays import Array
from .group import Group
from .planar_groups import SE2


def _join(vertical: Array, planar: Array) -> Array:
    return np.concatenate([vertical, planar], axis=-1)


class _RxSE2(Group):
    """ℝ × SE(2): translations in space and rotations about the z-axis.

    Pose: (z, x, y, θ) [m, m, m, rad], θ unwrapped.  Twist: (v3, v1, v2, ω) in the body frame
    [m/s, rad/s].  Momentum: (p3, p1, p2, L) in the body frame, L about its origin
    [kg·m/s, kg·m²/s].  The vertical entry is first, as in the product ℝ × SE(2).  In
    Pinocchio, the entries v1, v2, ω of a planar joint are adjacent, so only this order puts all
    translations first.
    """

    def identity(self) -> Array:
        return np.zeros(4)

    def compose(self, g: Array, h: Array) -> Array:
        return _join(g[..., :1] + h[..., :1], SE2.compose(g[..., 1:], h[..., 1:]))

    def inverse(self, g: Array) -> Array:
        return _join(-g[..., :1], SE2.inverse(g[..., 1:]))

    def exp(self, xi: Array) -> Array:
        return _join(xi[..., :1], SE2.exp(xi[..., 1:]))

    def log(self, g: Array) -> Array:
        return _join(g[..., :1], SE2.log(g[..., 1:]))

    def Ad(self, g: Array) -> Array:
        matrix = np.zeros((*g.shape[:-1], 4, 4))
        matrix[..., 0, 0], matrix[..., 1:, 1:] = 1.0, SE2.Ad(g[..., 1:])
        return matrix

    def ad(self, xi: Array) -> Array:
        matrix = np.zeros((*xi.shape[:-1], 4, 4))
        matrix[..., 1:, 1:] = SE2.ad(xi[..., 1:])
        return matrix

    def rate(self, g: Array, xi: Array) -> Array:
        return _join(xi[..., :1], SE2.rate(g[..., 1:], xi[..., 1:]))

    def matrix(self, g: Array) -> Array:
        """Compute the homogeneous matrix, (..., 4, 4), with axes in the order x, y, z."""
        planar = SE2.matrix(g[..., 1:])
        matrix = np.zeros((*g.shape[:-1], 4, 4))
        matrix[..., :2, :2], matrix[..., :2, 3] = planar[..., :2, :2], planar[..., :2, 2]
        matrix[..., 2, 2], matrix[..., 2, 3], matrix[..., 3, 3] = 1.0, g[..., 0], 1.0
        return matrix

    def from_matrix(self, matrix: Array) -> Array:
        planar = np.delete(np.delete(matrix, 2, axis=-1), 2, axis=-2)
        return _join(matrix[..., 2, 3:], SE2.from_matrix(planar))


RxSE2 = _RxSE2(
    name="RxSE2",
    axes=(2, 0, 1, 5),
    pose_names=("z", "x", "y", "θ"),
    root="prismatic with planar across it",
    joints=("PZ+Planar",),
    conserved="momentum and angular momentum about the centre of mass",
)
