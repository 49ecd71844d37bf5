"""The size of what weights do to each velocity, where what they do to each other may cancel.

A pendulum that hangs has no moment about its pivot, but the moments of its weights are numbers
with round-off, and these count m |g| times the arm of each body.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..system.scale import moved_masses


def weights(model: pin.Model, data: pin.Data, q: Array) -> Array:
    """Return Σ m |g| |c − p| over the bodies that each velocity moves, or Σ m |g|, (nv,) [N·m | N].

    c: centres of mass.  p: the place of the joint; a joint that slides has no arm.
    """
    out = np.zeros(model.nv)
    pull = float(np.linalg.norm(model.gravity.linear))
    if not pull:
        return out
    angular, mass = moved_masses(model, data, q)
    pin.forwardKinematics(model, data, q)
    bodies = range(1, model.njoints)
    force = np.array([pull * model.inertias[i].mass for i in bodies])
    centres = np.array([data.oMi[i].act(model.inertias[i].lever) for i in bodies])
    for i in bodies:
        joint = model.joints[i]
        own = slice(joint.idx_v, joint.idx_v + joint.nv)
        moved = np.array(list(model.subtrees[i])) - 1
        arms = np.linalg.norm(centres[moved] - data.oMi[i].translation, axis=1)
        out[own] = np.where(angular[own], float(force[moved] @ arms), pull * mass[own])
    return out
