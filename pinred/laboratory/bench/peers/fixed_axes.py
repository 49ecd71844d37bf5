"""Velocity of the root in engines that express its translation in fixed axes."""

from __future__ import annotations

import numpy as np

from ....common.arrays import Array
from ....system.system import System


def root_rotation(system: System, q: Array) -> Array:
    """Return the matrix (k, k) that rotates the root's linear velocity from body to fixed axes."""
    k, pose = system.group.linear, system.configuration(q).pose
    return system.group.Ad(pose)[:k, :k]


def frame_rotation_term(system: System, v: Array) -> Array:
    """Return ω × v of the root, (k,): the acceleration due to the rotation of body axes."""
    axes, k = list(system.group.axes), system.group.linear
    twist = np.zeros(6)
    twist[axes] = v[: system.r]
    return np.asarray(np.cross(twist[3:], twist[:3])[axes[:k]])
