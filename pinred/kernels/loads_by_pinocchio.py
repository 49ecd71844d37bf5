"""Generalised forces of wrenches on links, computed with Pinocchio's frame Jacobians.

The result τ = Jᵀ (F, N) validates forces/link_wrenches.py, with which it shares no formula.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..system.system import System


class LoadsByPinocchio:
    """The generalised forces of wrenches on the links of one system."""

    def __init__(
        self, system: System, axes: Array, places: Sequence[tuple[str | None, str]]
    ) -> None:
        """Find the frames of the links.

        Args:
            system: The system.
            axes: Motion axes of the root joint in its fixed frame, (6, r).
            places: For each wrench, the name of the link (None for the base) and the frame of its
                components ("world" or "body").
        """
        self._model, self._data = system.sorted_model, system.sorted_model.createData()
        self._axes, self._places = axes, tuple(places)
        self._to_world = system.model.jointPlacements[1].rotation
        self._frames = [None if link is None else self._frame(link) for link, _ in places]

    def _frame(self, link: str) -> int:
        """Return the index of the body with this name, or else of the frame with this name."""
        model = self._model
        if model.existBodyName(link):
            return int(model.getBodyId(link))
        return int(model.getFrameId(link))

    def generalised(self, q: Array, loads: Array) -> Array:
        """Compute the generalised forces of wrenches.

        Args:
            q: Pinocchio's configuration, (nq,).
            loads: Force, moment and point of each wrench, (9, L) [N, N·m, m].
        Returns:
            (nv,): the generalised forces.
        """
        model, data = self._model, self._data
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        tau = np.zeros(model.nv)
        reference = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        for (_, axes), frame, load in zip(self._places, self._frames, loads.T, strict=True):
            force, moment, point = load[:3], load[3:6], load[6:]
            if frame is None:  # along the group's axes in the root joint's fixed frame
                force, moment = np.split(self._axes @ load[: self._axes.shape[1]], 2)
                to_world, arm = self._to_world, np.zeros(3)
                jacobian = pin.getJointJacobian(model, data, 1, reference)
            else:
                orientation = data.oMf[frame].rotation
                to_world = self._to_world if axes == "world" else orientation
                arm = orientation @ point
                jacobian = pin.getFrameJacobian(model, data, frame, reference)
            F = to_world @ force
            tau += jacobian.T @ np.concatenate([F, to_world @ moment + pin.skew(arm) @ F])
        return tau
