"""A satellite turns to a given attitude: with reaction wheels, and with thrusters that pulse.

Both laws are quaternion feedback, τ = −kp sgn(q₄) q − kd ω, in the axes of the bus.  The wheels
give it as a torque that sees the attitude, so that momentum stays constant.  The thrusters are
either on or off: each axis fires twice a second, for a part of the time (pulse width), and its
controller keeps a state of its own, the integral of the error, against sunlight on the panel.
"""

from functools import partial
from typing import Any

import casadi as ca
import numpy as np

import pinred
from pinred.forces import Command, Controller, Damper, SeenState, Spring, Torque, Wrench

satellite = pinred.load("reaction_wheel_satellite")
wheels = ("wheel_x", "wheel_y", "wheel_z")
turned = np.array([0.6, -0.3, 0.5])
turned = np.append(turned, np.sqrt(1.0 - turned @ turned))  # 114 degrees from the goal
hinge = [Spring("panel_hinge", 20.0), Damper("panel_hinge", 6.0)]
near = ca.cos(ca.pi / 360.0)  # half of one degree
start: dict[str, Any] = {"pose0": [0.0, 0.0, 0.0, *turned], "x0": [0.0] * 4, "rtol": 1e-8}


# --- reaction wheels -------------------------------------------------------------------------
def feedback(s: SeenState) -> dict[str, ca.SX]:
    """Return the torques of the wheels: the bus is turned by what turns them, the other way."""
    q, omega = s.pose[3:], s.xi[3:]
    shorter = ca.sign(q[3])  # q and −q are one attitude
    return {name: 3.0 * shorter * q[k] + 6.0 * omega[k] for k, name in enumerate(wheels)}


def closeness(s: SeenState) -> ca.SX:
    """Return what is positive within one degree of the goal."""
    return ca.SX(ca.fabs(s.pose[6]) - near)


by_wheels = pinred.simulate(
    satellite,
    **start,
    duration=20.0,
    forces=[Torque(feedback, name="wheels"), *hinge],
    events=[pinred.Event(closeness, "settled", direction=1)],
    explain=True,
)
print("wheels: within a degree at t =", by_wheels.events["settled"].t, "s")
print("momentum stays:", np.abs(by_wheels.spatial_momentum).max(), "N m s")
print(pinred.compare(by_wheels))

# --- thrusters -------------------------------------------------------------------------------
PERIOD, MOST, LEAST = 0.5, 2.0, 0.005  # s, N m, s


def pulse(axis: int, t: float, integral: float, seen: SeenState) -> tuple[Command, float]:  # noqa: ARG001
    """Return a pulse about one axis of the wanted impulse, and the integral of the error."""
    error = np.sign(seen.pose[6]) * seen.pose[3 + axis]
    wanted = -3.0 * error - 0.02 * integral - 5.0 * seen.xi[3 + axis]
    width = PERIOD * min(abs(wanted) / MOST, 1.0)
    wrench = np.zeros(6)
    wrench[3 + axis] = MOST * np.sign(wanted)
    if abs(error) < 0.05:  # not on the way there, which would wind it up
        integral += error * PERIOD
    return Command(wrench=wrench, width=width if width >= LEAST else 0.0), integral


thrusters = [
    Controller(partial(pulse, k), PERIOD, name=f"thrusters {axis}", wrench=True, state0=0.0)
    for k, axis in enumerate("xyz")
]
sunlight = Wrench([0.0, 0.0, -1e-3], link="panel", at=(0.5, 0.0, 0.0), frame="world")
locked = pinred.load("reaction_wheel_satellite", lock=wheels)
by_thrusters = pinred.simulate(
    locked,
    **(start | {"x0": [0.0]}),
    duration=20.0,
    forces=[*thrusters, sunlight, *hinge],
    events=[pinred.Event(closeness, "settled", direction=1)],
)
fired = sum(action.width or 0.0 for action in by_thrusters.actions)
print("thrusters: within a degree at t =", by_thrusters.events["settled"].t, "s")
print(f"{len(by_thrusters.actions)} calls, fired for {fired:.2f} s")
print(pinred.compare(by_thrusters))
