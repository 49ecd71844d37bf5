# %% [markdown]
# # 20. solo12 drops and lands
#
# A quadruped falls, turns in flight, hits the stops of its legs, and meets the ground with one
# foot. The ground stops this foot dead: an impulse acts on it alone, and all velocities jump. From
# then on, the robot is a pendulum about the foot. Of its six symmetries only the rotation about the
# vertical is left. It needs the extra `robots`.

# %%
from typing import Any

import numpy as np
import pinocchio as pin

import pinred
from pinred.forces import Damper, Spring

solo = pinred.load("solo12")
legs = {"HAA": 0.0, "HFE": 0.6, "KFE": -1.2}
stand = {name: legs[name[3:]] * (-1.0 if name[0] == "H" else 1.0) for name in solo.shape_names}
feet = [name[:2] + "_FOOT" for name in solo.shape_names if name.endswith("HAA")]

# %% [markdown]
# ## Flight
# Springs and dampers hold the legs, as weak servos do, within stops 0.01 rad on either side. At the
# start only the trunk rotates, so legs swing into their stops; these impulses are internal. The
# formula height['FL_FOOT'] watches a foot: where the first one comes down to the ground, the flight
# ends.

# %%
servos: list[Spring | Damper] = [Spring(name, 0.3, angle) for name, angle in stand.items()]
servos += [Damper(name, 0.01) for name in stand]
touches = [pinred.Event(f"height['{foot}']", foot, terminal=True, direction=-1) for foot in feet]
stops = {name: (angle - 0.01, angle + 0.01) for name, angle in stand.items()}
options: dict[str, Any] = {"x0": stand, "forces": servos, "stops": stops, "events": touches}
flight = pinred.simulate(
    solo, pose0=[0, 0, 0.6, 0, 0, 0, 1], xi0=[0, 0, 0, 0.6, -0.9, 0.0], duration=2.0, **options
)
foot = str(flight.ended_by)
print(f"{foot} meets the ground at t = {flight.t[-1]:.6f} s")
print(f"{len(flight.impacts)} impacts at stops, the first:")
print(*str(flight.impacts).splitlines()[:2], sep="\n")
fallen = 0.5 * 9.81 * flight.t[-1] ** 2
frames = solo.model.createData()
start, end = (pin.centerOfMass(solo.model, frames, q)[2] for q in flight.q[[0, -1]])
print(f"the centre of mass fell {start - end:.6f} m, by hand {fallen:.6f} m")
np.testing.assert_allclose(start - end, fallen, atol=1e-9)

# %% [markdown]
# ## Touch-down
# `land` stops the origin of the foot. By hand, this is one linear system: the impulse λ acts along
# the three rows J of the foot, and J v⁺ = 0.

# %%
landing = pinred.land(flight, foot)
print(landing)
state, data = flight(flight.t[-1]), solo.model.createData()
H = np.triu(pin.crba(solo.model, data, state.q))
H += np.triu(H, 1).T
pin.computeJointJacobians(solo.model, data, state.q)
pin.updateFramePlacements(solo.model, data)
aligned = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
number = solo.model.getFrameId(foot, pin.FrameType.BODY)
J = pin.getFrameJacobian(solo.model, data, number, aligned)[:3]
impulse = np.linalg.solve(J @ np.linalg.solve(H, J.T), -J @ state.v)
print("impulse by hand:", impulse, "N s")
np.testing.assert_allclose(landing.impulse[0], impulse, atol=1e-11)
assert landing.pulled == ()  # the ground pushes

# %% [markdown]
# The momentum of a robot in flight is constant but for its weight. This impulse is external: the
# momentum jumps by it, and by its moment about the origin of the world.

# %%
at = data.oMf[number].translation
jump = np.concatenate([impulse, np.cross(at, impulse)])
np.testing.assert_allclose(landing.momentum_jump, jump, atol=1e-11)

# %% [markdown]
# ## Stance
# The same tree, with its root at the foot, is the robot in stance. Its group is SO(2) about the
# vertical; two tilts of the foot and the legs are its shape. Its momentum about the vertical
# through the foot is constant, because neither the ground nor gravity has a moment about it.

# %%
assert landing.stance is not None
robot: pinred.System = landing.stance.system
onward: dict[str, Any] = dict(landing.stance.start)
others = [pinred.Event(f"height['{f}']", f, terminal=True, direction=-1) for f in feet if f != foot]
stance = pinred.simulate(robot, **onward, forces=servos, events=others, duration=1.0)
print(robot, "until", stance.ended_by, f"lands after {stance.t[-1]:.4f} s")
spin = stance.spatial_momentum[:, 0]
print("momentum about the vertical:", spin[0], "N m s")
np.testing.assert_allclose(spin, spin[0], atol=1e-9)

# %% [markdown]
# ## The second foot
# The next foot lands while the first one stands. Two points leave no symmetry, so here the motion
# goes on in another tool. The chain of flight, impact and stance is one motion, which `compare`
# repeats by ABA and by full mass matrices.

# %%
second = pinred.land(stance, str(stance.ended_by))
print(second)
chain = pinred.chain(flight, landing, stance)
report = pinred.compare(chain)
print(report.impacts[0])
assert report
figure = pinred.plot(chain, "energy")
