# %% [markdown]
# # 16. Attitude control
#
# A satellite turns to a given attitude: by reaction wheels, and by thrusters that pulse. Both laws
# are quaternion feedback in the axes of the bus, τ = −kp sgn(q₄) q − kd ω, with q the attitude off
# the goal; they differ in what they may do. Wheels only exchange angular momentum with the bus, and
# that of the whole stays constant; thrusters change it, and are either on or off.

# %%
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
start: dict[str, Any] = {"pose0": [0.0, 0.0, 0.0, *turned], "x0": [0.0] * 4, "rtol": 1e-8}
near = ca.cos(ca.pi / 360.0)  # half of one degree


def closeness(s: SeenState) -> ca.SX:
    """Return what is positive within one degree of the goal."""
    return ca.SX(ca.fabs(s.pose[6]) - near)


# %% [markdown]
# ## Reaction wheels
# The law is a smooth function of the state, and stands in the compiled equations as a Torque that
# sees the attitude. The bus is turned by what turns the wheels, the other way; q and −q are one
# attitude, and sgn(q₄) takes the shorter way. `explain` says what is seen, and that momentum is
# constant.


# %%
def feedback(s: SeenState) -> dict[str, ca.SX]:
    """Return the torques of the wheels."""
    q, omega = s.pose[3:], s.xi[3:]
    shorter = ca.sign(q[3])
    return {name: 3.0 * shorter * q[k] + 6.0 * omega[k] for k, name in enumerate(wheels)}


settled = pinred.Event(closeness, "settled", direction=1)
by_wheels = pinred.simulate(
    satellite,
    **start,
    duration=20.0,
    forces=[Torque(feedback, name="wheels"), *hinge],
    events=[settled],
    explain=True,
)
print("wheels: within a degree at t =", by_wheels.events["settled"].t, "s")
print("momentum stays:", np.abs(by_wheels.spatial_momentum).max(), "N m s")
np.testing.assert_allclose(by_wheels.spatial_momentum, 0.0, atol=1e-12)
report = pinred.compare(by_wheels)
print(report)
assert report.passed

# %% [markdown]
# ## Thrusters
# The wheels are locked. Each axis fires twice a second with the one moment it has, for the part of
# the half second (pulse width) that gives the wanted impulse: `Command(width=…)`. Sunlight on the
# panel turns the satellite all the time, and a proportional law would stay off the goal; so each
# Controller keeps a state of its own, the integral of the error.

# %%
PERIOD, MOST, LEAST = 0.5, 2.0, 0.005  # s, N m, s


def pulse(axis: int, _t: float, integral: float, seen: SeenState) -> tuple[Command, float]:
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
by_thrusters = pinred.simulate(
    pinred.load("reaction_wheel_satellite", lock=wheels),
    **(start | {"x0": [0.0]}),
    duration=20.0,
    forces=[*thrusters, sunlight, *hinge],
    events=[settled],
)
fired = sum(action.width or 0.0 for action in by_thrusters.actions)
print("thrusters: within a degree at t =", by_thrusters.events["settled"].t, "s")
print(f"{len(by_thrusters.actions)} calls, fired for {fired:.2f} s")

# %% [markdown]
# ## Confirmed
# Sunlight has pushed with a millinewton for 20 s, and moments give no force. `compare` repeats the
# flight by full ABA: the actions that the controllers took are replayed, and what they were given
# is judged by Pinocchio.

# %%
np.testing.assert_allclose(by_thrusters.spatial_momentum[-1, :3], [0.0, 0.0, -0.02], atol=1e-9)
report = pinred.compare(by_thrusters)
print(report)
assert report.passed
