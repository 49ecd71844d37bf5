"""Compare random trees under forces with ABA."""

from __future__ import annotations

import aba
import numpy as np
from trees import random_model

import pinred

# A gravity vector that keeps the symmetry of each group [m/s²].
GRAVITY = {
    "R": (1.0, -2.0, 3.0), "SE2": (1.0, -2.0, 3.0), "SO3": (2.0, 0.0, -3.0),
    "SE3": (0.5, 0.0, -3.0), "RxSE2": (1.0, -2.0, -3.0),
}  # fmt: skip


def tree(group: str, joints: int, seed: int) -> pinred.System:
    """Return a random tree, with gravity if its group allows it."""
    model = random_model(group, joints, seed)
    model.gravity.linear = np.array(GRAVITY.get(group, (0.0, 0.0, 0.0)))
    return pinred.load(model)


def against_aba(traj: pinred.Trajectory, tau: aba.Torques, stops: tuple[float, ...] = ()) -> float:
    """Return the largest difference between a trajectory and ABA with torques tau [rad | m]."""
    model = traj.system.model
    q, _ = aba.integrate(model, traj.q[0], traj.v[0], traj.t, tau, rtol=1e-10, stops=stops)
    return aba.max_difference(model, q, traj.q)
