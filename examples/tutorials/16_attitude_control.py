# %% [markdown]
# # 16. Attitude control
#
# A satellite rotates to a given attitude, by reaction wheels and by pulsed thrusters. Both
# controllers use quaternion feedback in the axes of the bus, τ = −kp sgn(q₄) q − kd ω, where q is
# the attitude relative to the goal. Wheels only exchange angular momentum with the bus, so the
# total is constant. Thrusters change the total, and are either on or off.

# %%
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

import pinred
from pinred.forces import Command, Controller, Damper, SeenState, Spring, Torque, Wrench

satellite = pinred.load("reaction_wheel_satellite")
wheels = ("wheel_x", "wheel_y", "wheel_z")
quaternion = np.array([0.6, -0.3, 0.5])
quaternion = np.append(quaternion, np.sqrt(1.0 - quaternion @ quaternion))  # 114° from the goal
hinge = [Spring("panel_hinge", 20.0), Damper("panel_hinge", 6.0)]
start: dict[str, Any] = {"pose0": [0.0, 0.0, 0.0, *quaternion], "x0": [0.0] * 4, "rtol": 1e-8}
near = ca.cos(ca.pi / 360.0)  # half of one degree


def closeness(s: SeenState) -> ca.SX:
    """Return an expression that is positive within one degree of the goal."""
    return ca.SX(ca.fabs(s.pose[6]) - near)


# %% [markdown]
# ## Reaction wheels
# The control law is a smooth function of the state. A Torque that observes the attitude includes it
# in the compiled equations. The bus receives the opposite torque of the wheels. q and −q are the
# same attitude, and sgn(q₄) selects the shorter rotation. `explain` lists the observed quantities,
# and that momentum is constant.


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
# The wheels are locked. Each axis fires twice a second with a constant moment; the pulse width
# within the half second gives the requested impulse: `Command(width=…)`. Sunlight on the panel
# exerts a steady moment, which gives a proportional law a permanent error. So each Controller has a
# state, the integral of the error.

# %%
PERIOD, MOST, LEAST = 0.5, 2.0, 0.005  # period [s], moment [N m], shortest pulse [s]


def pulse(axis: int, _t: float, integral: float, seen: SeenState) -> tuple[Command, float]:
    """Return a pulse with the requested impulse about one axis, and the integral of the error."""
    error = np.sign(seen.pose[6]) * seen.pose[3 + axis]
    impulse = -3.0 * error - 0.02 * integral - 5.0 * seen.xi[3 + axis]
    width = PERIOD * min(abs(impulse) / MOST, 1.0)
    wrench = np.zeros(6)
    wrench[3 + axis] = MOST * np.sign(impulse)
    if abs(error) < 0.05:  # only near the goal, to avoid wind-up
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
# ## Validation by ABA
# The force of sunlight of a millinewton acted for 20 s; moments change no linear momentum.
# `compare` repeats the flight by full ABA with the recorded controller actions, and validates the
# measurements that the controllers received.

# %%
np.testing.assert_allclose(by_thrusters.spatial_momentum[-1, :3], [0.0, 0.0, -0.02], atol=1e-9)
report = pinred.compare(by_thrusters)
print(report)
assert report.passed
