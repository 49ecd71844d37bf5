"""Magnitude of the gravity load on each velocity coordinate, without cancellation.

A hanging pendulum has no gravity moment about its pivot. The moments of its bodies are numbers
with round-off all the same, proportional to m |g| times the lever arm of each body.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..system.scale import moved_masses


def gravity_load_sizes(model: pin.Model, data: pin.Data, q: Array) -> Array:
    """Compute Σ m |g| |c − p| over the bodies that each velocity coordinate moves.

    Args:
        model: Model with its gravity.
        data: Work space of the model.
        q: Pinocchio's configuration, (nq,).
    Returns:
        (nv,) [N·m | N]. c is a body's centre of mass and p the position of the joint.
        Prismatic joints have no lever arm; their entry is Σ m |g|.
    """
    loads = np.zeros(model.nv)
    g = float(np.linalg.norm(model.gravity.linear))
    if not g:
        return loads
    angular, mass = moved_masses(model, data, q)
    pin.forwardKinematics(model, data, q)
    bodies = range(1, model.njoints)
    force = np.array([g * model.inertias[i].mass for i in bodies])
    centres = np.array([data.oMi[i].act(model.inertias[i].lever) for i in bodies])
    for i in bodies:
        joint = model.joints[i]
        columns = slice(joint.idx_v, joint.idx_v + joint.nv)
        subtree = np.array(list(model.subtrees[i])) - 1
        arms = np.linalg.norm(centres[subtree] - data.oMi[i].translation, axis=1)
        loads[columns] = np.where(angular[columns], float(force[subtree] @ arms), g * mass[columns])
    return loads
