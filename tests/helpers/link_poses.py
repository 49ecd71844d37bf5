"""Poses of links relative to the root, by Pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from pinred.analysis.connections.drag_fluid_and_wheels import link_named
from pinred.common.arrays import Array
from pinred.system.system import System


def link_pose(system: System, name: str, x: Array) -> Array:
    """Return the pose coordinates of a link relative to the root at shape x."""
    link, model = link_named(system, name, "the base"), system.sorted_model
    data = system.sorted_data
    pin.forwardKinematics(model, data, system.sorted_q(system.group.identity(), x))
    place = data.oMi[1].actInv(data.oMi[link.joint]) * link.placement
    group, matrix = system.group, np.array(place.homogeneous)
    linear = matrix[[axis for axis in group.axes if axis < 3], 3]
    if group.turns == 3:
        return np.concatenate([linear, np.array(pin.Quaternion(matrix[:3, :3]).coeffs())])
    angle = [np.arctan2(matrix[1, 0], matrix[0, 0])] if group.turns else []
    return np.concatenate([linear, angle])
