# %% [markdown]
# # 18. A robot with parallel legs turns over in the air
#
# Each leg of the biped is a five-bar: two thighs on hips 0.1 m apart, and two shins that meet at
# the foot. The loops are constraints between links of the robot, so momentum is conserved as in a
# tree. In flight, motors turn both legs round, and the torso turns the other way: ξ = −A G u̇, with
# the rates u̇ of the hips. The knees follow, ẋ = G u̇.

# %%
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
from scipy.optimize import brentq

import pinred
from pinred.signals import Expression

drawing = find_spec("matplotlib") is not None  # figures need the extra `plots`
robot = pinred.load("parallel_biped")
closure = robot.closure
assert closure is not None
print(f"{robot.m} joints, {closure.equations} equations of the loops, of rank {closure.rank}")
hips = [f"{side}_{end}_hip" for side in ("left", "right") for end in ("front", "rear")]
assert robot.shape_dim == len(hips)

# %% [markdown]
# ## The phase of one turn of the legs
# The hips are independent joints. In a turn of the legs, all hips turn at one rate, and the knees
# follow. A wider angle between the thighs pulls the foot in: shorter legs turn the torso less.

# %%
TURNS, FLIGHT = 4, 0.9  # number of turns; duration of the flight [s]
connection = pinred.Connection.mechanical(robot, independent=hips)
constant = np.zeros((1, len(hips)))


def turned(half: float) -> tuple[float, pinred.Gait]:
    """Return the pitch of the torso after one turn [rad], for half the angle of the thighs."""
    gait = pinred.Gait.fourier(
        [-half, half] * 2, constant, constant, turns=[1] * len(hips), period=FLIGHT / TURNS
    )
    return float(pinred.phase(connection, gait).log[4]), gait


for half in (0.3, 0.6, 0.9, 1.2):
    print(
        f"thighs at ±{half} rad: one turn pitches the torso by {np.degrees(turned(half)[0]):.3f}°"
    )
half = brentq(lambda half: turned(half)[0] + 2.0 * np.pi / TURNS, 0.3, 1.2, xtol=1e-12)
pitch, gait = turned(half)
print(f"at ±{half:.6f} rad, {TURNS} turns pitch it by {TURNS * np.degrees(pitch):.6f}°")

# %% [markdown]
# ## The flight
# Motors at the hips follow the plan by proportional and derivative control, so they lag a little.
# The initial state names the hips only; the other joints close the loops. Gravity moves the centre
# of mass along a parabola.

# %%
rate = 2.0 * np.pi / gait.period
start = dict(zip(hips, [-half, half] * 2, strict=True))
plan = {name: Expression(f"{angle} + {rate}*t") for name, angle in start.items()}
traj = pinred.simulate(
    robot,
    x0=start,
    xdot0=dict.fromkeys(hips, rate),
    momentum=0,
    forces=[pinred.forces.PD(plan, kp=1000.0, kd=20.0)],
    duration=FLIGHT,
)
at = [robot.shape_names.index(name) for name in hips]
lag = np.abs(traj.x[-1, at] - [start[name] + rate * FLIGHT for name in hips]).max()
missed = robot.group.error(traj.pose[0], traj.pose[-1]).rotation
print(f"the torso misses its first attitude by {np.degrees(missed):.3f}°")
print(f"the hips lag behind the plan by up to {np.degrees(lag):.3f}°")
assert missed < 10.0 * lag

# %% [markdown]
# At zero momentum, the torso follows the hips at every time: ξ = −A G u̇.

# %%
reduction = pinred.LoopReduction(robot, independent=hips)
order = [robot.shape_names.index(name) for name in reduction.at(traj.x[0]).independent]
errors = [
    traj.xi[k, 3:] + (reduction.at(traj.x[k]).local_connection @ traj.xdot[k, order])[3:]
    for k in range(0, len(traj), 20)
]
print(f"largest error of ξ + A G u̇: {np.abs(errors).max():.1e} rad/s")
np.testing.assert_allclose(errors, 0.0, atol=1e-9)

# %% [markdown]
# The multipliers of the loops are the forces in the feet.

# %%
force = np.linalg.norm(traj.loop_forces["left_foot"][:, :3], axis=1)
print(f"the shins hold the left foot together with {force.min():.3f} to {force.max():.3f} N")

# %% [markdown]
# ## The judge
# The reference integrates all joints with Pinocchio's ABA and multipliers for the loops, here over
# the first quarter of a turn.

# %%
report = pinred.compare(pinred.simulate(replace(traj.scene, duration=0.25 * gait.period)))
print(report)
if not report.passed:
    raise SystemExit("the reduced motion is not that of the full simulation")

# %% [markdown]
# `traj.play()` shows the motion; all joints of the loops move.

# %%
pinred.plot(traj, "base") if drawing else None
