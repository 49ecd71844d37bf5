"""A controller in plain Python, sampled at 50 Hz with zero-order hold of its torques.

The cat spins slowly; the controller damps its joints and moves them to a goal. The change of
energy equals the work of the controller. The reference simulation by ABA applies the same torques.
"""

import numpy as np
from numpy.typing import NDArray

import pinred
from pinred.forces import Controller, Limit

Array = NDArray[np.float64]

cat = pinred.load("falling_cat")
goal = np.array([0.6, -0.4, 0.2])


def control(t: float, x: Array, xdot: Array, mu: Array) -> Array:  # noqa: ARG001
    """Return the torques of all joints, from the state at time t."""
    return 3.0 * (goal - x) - 0.4 * xdot


traj = pinred.simulate(
    cat,
    x0=[0.0, 0.1, -0.1],
    xi0=[0.0, 0.0, 0.0, 0.4, -0.2, 0.3],
    duration=1.5,
    forces=[Controller(control, period=0.02, limit=Limit(1.0, smooth=True))],
)
balance = traj.energy_balance
print("remaining distance to the goal:", np.abs(traj.x[-1] - goal).max(), "rad")
print("work of the controller:", balance.work[-1, 0], "J; residual:", balance.residual[-1], "J")
print(pinred.compare(traj))
