"""Do a route's accelerations agree with Pinocchio's?  A line of the judge that needs no bound on
how motions part, and no tolerance: both sides are taken at the same states.

What is judged is the force that the difference of accelerations stands for, H Δa, joint by
joint and in parts of what that joint's equation is a sum of.  So a light joint counts by its own
size, and a bad condition of H stretches nothing.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..simulation.accelerations import accelerations
from ..simulation.trajectory import Trajectory
from .full_state import FullState


def equation_errors(traj: Trajectory, full: FullState, times: Array) -> Array:
    """Return the relative errors (T, n) of the equations of motion at times (T,).

    full: the system whose motion it is meant to be.  Rows of joints that follow a plan are zero.
    """
    found = accelerations(traj.motion, times)
    states, out = found.states, np.zeros_like(found.v)
    for k, t in enumerate(times.tolist()):
        y = full.state(states.pose[k], states.x[k], states.xi[k], states.xdot[k])
        out[k] = full.force_error(t, y, found.a[k])
    return out
