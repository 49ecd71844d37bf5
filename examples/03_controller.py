"""A controller in plain Python, sampled at 50 Hz: its torques are held between the samples.

The cat has some spin; the controller damps its joints and pulls them to a pose.  Energy changes
by the work that the controller does, and the full simulation is given the same torques.
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
print("left of the way to the goal:", np.abs(traj.x[-1] - goal).max(), "rad")
print("work of the controller:", balance.work[-1, 0], "J; left over:", balance.residual[-1], "J")
print(pinred.compare(traj))
