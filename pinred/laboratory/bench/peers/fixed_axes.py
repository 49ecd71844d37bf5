"""The root's velocity as engines have it that measure its translation along fixed axes."""

from __future__ import annotations

import numpy as np

from ....common.arrays import Array
from ....system.system import System


def turn(system: System, q: Array) -> Array:
    """Return the matrix of the root's linear velocity from its own axes to fixed ones, (k, k)."""
    k, pose = system.group.linear, system.configuration(q).pose
    return system.group.Ad(pose)[:k, :k]


def carried(system: System, v: Array) -> Array:
    """Return ω × v of the root, (k,): by that its own axes carry the linear velocity along."""
    axes, k = list(system.group.axes), system.group.linear
    space = np.zeros(6)
    space[axes] = v[: system.r]
    return np.asarray(np.cross(space[3:], space[:3])[axes[:k]])
