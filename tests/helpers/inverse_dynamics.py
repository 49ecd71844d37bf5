"""Torques at zero momentum by Pinocchio's RNEA: the other side of tests of torques."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from assertions import close

import pinred
from pinred.common.arrays import Array


def joint_torques(system: pinred.System, x: Array, xdot: Array, xddot: Array) -> Array:
    """Torques of the joints by RNEA, where the base moves so that its momentum stays zero."""
    model, data = system.model.copy(), system.model.createData()
    model.gravity.setZero()
    red = pinred.Reduction(system)
    xi = -red.local_connection(x) @ xdot
    q, v = system.q(system.group.identity(), x), system.v(xi, xdot)
    # RNEA is affine in the acceleration: find that of the base for which its wrench vanishes.
    r = system.r
    free = pin.rnea(model, data, q, v, system.v(np.zeros(r), xddot))
    H = red.mass_matrix(x)
    base = -np.linalg.solve(H[:r, :r], free[:r])
    whole = pin.rnea(model, data, q, v, system.v(base, xddot))
    close(whole[:r], np.zeros(r), 1e-10)
    return np.asarray(whole[r:])
