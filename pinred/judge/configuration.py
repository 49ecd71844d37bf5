"""Pinocchio's configuration q of the coordinates that the full simulation integrates."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from .root_motion import RootMotion


class Configuration:
    """The map to q of root coordinates and the unwrapped values of all M joints."""

    def __init__(self, model: pin.Model, root: RootMotion) -> None:
        """Find the joints whose angle Pinocchio keeps as cosine and sine."""
        joints = list(model.joints[2:])
        circles = np.array([joint.nq == 2 for joint in joints], dtype=bool)
        first = np.array([joint.idx_q for joint in joints], dtype=np.intp)
        self._root, self._nq, self._any = root, model.nq, bool(circles.any())
        self._circles, self._cosines = np.flatnonzero(circles), first[circles]
        self._straight, self._values = np.flatnonzero(~circles), first[~circles]

    def __call__(self, root: Array, joints: Array) -> Array:
        """Return q (nq,) of root coordinates (size,) and joints (M,)."""
        begin = self._root.q(root)
        if not self._any:
            return np.concatenate([begin, joints])
        q, angles = np.empty(self._nq), joints[self._circles]
        q[: len(begin)] = begin
        q[self._values] = joints[self._straight]
        q[self._cosines], q[self._cosines + 1] = np.cos(angles), np.sin(angles)
        return q
