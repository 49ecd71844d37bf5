"""Wrenches on links by Jacobians of Pinocchio's frames: for the judges of kernels and motions.

Their own way from a wrench at a point of a link to forces on the coordinates, τ = Jᵀ (F, N),
which shares nothing with forces/link_loads.py.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..system.system import System


class LoadsByPinocchio:
    """The wrenches on the links of one system.  places: link, None for the base, and axes of each.

    axes: (6, r) of the root's motion in its fixed frame.
    """

    def __init__(
        self, system: System, axes: Array, places: Sequence[tuple[str | None, str]]
    ) -> None:
        """Find the frames by name."""
        self._model, self._data = system.model, system.model.createData()
        self._axes, self._places = axes, tuple(places)
        self._to_world = system.model.jointPlacements[1].rotation
        self._frames = [None if link is None else self._frame(link) for link, _ in places]

    def _frame(self, link: str) -> int:
        """Return the frame of a body of this name, or of what else has it."""
        model = self._model
        if model.existBodyName(link):
            return int(model.getBodyId(link))
        return int(model.getFrameId(link))

    def generalised(self, q: Array, loads: Array) -> Array:
        """Return the forces (nv,) of loads (9, L), entries and point of each, at q."""
        model, data = self._model, self._data
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        out = np.zeros(model.nv)
        reference = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        for (_, axes), frame, load in zip(self._places, self._frames, loads.T, strict=True):
            force, moment, point = load[:3], load[3:6], load[6:]
            if frame is None:  # along the group's axes in the root joint's fixed frame
                both = self._axes @ load[: self._axes.shape[1]]
                turn, arm = self._to_world, np.zeros(3)
                force, moment = both[:3], both[3:]
                jacobian = pin.getJointJacobian(model, data, 1, reference)
            else:
                placement = data.oMf[frame].rotation
                turn = self._to_world if axes == "world" else placement
                arm = placement @ point
                jacobian = pin.getFrameJacobian(model, data, frame, reference)
            pull = turn @ force
            out += jacobian.T @ np.concatenate([pull, turn @ moment + pin.skew(arm) @ pull])
        return out
