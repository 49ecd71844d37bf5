"""Joint torques at zero momentum by Pinocchio's RNEA: an independent reference."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from assertions import close

import pinred
from pinred.common.arrays import Array


def joint_torques(system: pinred.System, x: Array, xdot: Array, xddot: Array) -> Array:
    """Return the joint torques by RNEA for a motion at zero momentum, (m,) [N m | N].

    Args:
        system: The system, whose gravity is ignored.
        x: Shape, (m,) [rad | m].
        xdot: Shape rate, (m,) [rad/s | m/s].
        xddot: Shape acceleration, (m,) [rad/s² | m/s²].
    """
    model, data = system.model.copy(), system.model.createData()
    model.gravity.setZero()
    red = pinred.Reduction(system)
    xi = -red.local_connection(x) @ xdot
    q, v = system.q(system.group.identity(), x), system.v(xi, xdot)
    # RNEA is affine in the acceleration: solve for the base acceleration with zero base wrench.
    r = system.r
    free = pin.rnea(model, data, q, v, system.v(np.zeros(r), xddot))
    H = red.mass_matrix(x)
    base_acceleration = -np.linalg.solve(H[:r, :r], free[:r])
    forces = pin.rnea(model, data, q, v, system.v(base_acceleration, xddot))
    close(forces[:r], np.zeros(r), 1e-10)
    return np.asarray(forces[r:])
