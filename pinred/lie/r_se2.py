"""ℝ × SE(2): motions of a plane that climbs along its normal, known as Schoenflies's.

What is held upright moves so: a ship in heave, a drone or a blimp that keeps its attitude, a
load on a crane, the hand of a SCARA robot.  The climb comes first, as ℝ does in the product:
a pose is (z, x, y, θ), a twist (v3, v1, v2, ω).  (Pinocchio has v1, v2, ω in a row, and only
before them is a climb among the translations.)
"""

from __future__ import annotations

import numpy as np

from ..common.arrays import Array
from .group import Group
from .se2 import SE2


def _both(climb: Array, planar: Array) -> Array:
    return np.concatenate([climb, planar], axis=-1)


class _RxSE2(Group):
    def identity(self) -> Array:
        return np.zeros(4)

    def compose(self, g: Array, h: Array) -> Array:
        return _both(g[..., :1] + h[..., :1], SE2.compose(g[..., 1:], h[..., 1:]))

    def inverse(self, g: Array) -> Array:
        return _both(-g[..., :1], SE2.inverse(g[..., 1:]))

    def exp(self, xi: Array) -> Array:
        return _both(xi[..., :1], SE2.exp(xi[..., 1:]))

    def log(self, g: Array) -> Array:
        return _both(g[..., :1], SE2.log(g[..., 1:]))

    def Ad(self, g: Array) -> Array:
        out = np.zeros((*g.shape[:-1], 4, 4))
        out[..., 0, 0], out[..., 1:, 1:] = 1.0, SE2.Ad(g[..., 1:])
        return out

    def ad(self, xi: Array) -> Array:
        out = np.zeros((*xi.shape[:-1], 4, 4))
        out[..., 1:, 1:] = SE2.ad(xi[..., 1:])
        return out

    def rate(self, g: Array, xi: Array) -> Array:
        return _both(xi[..., :1], SE2.rate(g[..., 1:], xi[..., 1:]))

    def matrix(self, g: Array) -> Array:
        """Return the homogeneous matrix of space, (..., 4, 4), its axes x, y, z in order."""
        planar = SE2.matrix(g[..., 1:])
        out = np.zeros((*g.shape[:-1], 4, 4))
        out[..., :2, :2], out[..., :2, 3] = planar[..., :2, :2], planar[..., :2, 2]
        out[..., 2, 2], out[..., 2, 3], out[..., 3, 3] = 1.0, g[..., 0], 1.0
        return out

    def from_matrix(self, matrix: Array) -> Array:
        planar = np.delete(np.delete(matrix, 2, axis=-1), 2, axis=-2)
        return _both(matrix[..., 2, 3:], SE2.from_matrix(planar))


RxSE2 = _RxSE2(
    name="RxSE2",
    axes=(2, 0, 1, 5),
    pose_names=("z", "x", "y", "θ"),
    root="prismatic with planar across it",
    joints=("PZ+Planar",),
    conserved="momentum and angular momentum about the centre of mass",
)
