# %% [markdown]
# # 19. Catching a tumbling satellite
#
# A satellite with an arm and three wheels catches a body that tumbles, and stops the rotation with
# its wheels. The catch is an impact: the two robots become one within no time. Their momentum is
# pulled back to the motions that both can share, p⁺ = JᵀHv⁻, so its sum stays, and energy is lost.

# %%
import numpy as np
import pinocchio as pin

import pinred
from pinred.forces import Damper, SeenState, Spring, Torque

still = (0.0, 0.0, 0.0)
model = pinred.Model("chaser").body("bus", mass=60.0, inertia=[6.0, 5.0, 7.0])
for axis in "xyz":
    spin = [0.04 + 0.04 * (axis == k) for k in "xyz"]
    model = model.hinge(f"wheel_{axis}", parent="bus", axis=axis, mass=2.0, inertia=spin)
model = (
    model.hinge("shoulder", parent="bus", axis="z", at=(0.4, 0, 0), mass=4.0, inertia=0.2)
    .hinge("elbow", parent="shoulder", axis="y", at=(0.6, 0, 0), mass=3.0, inertia=0.1)
    .fixed("grip", parent="elbow", at=(0.5, 0, 0))
)  # fmt: skip
chaser = pinred.load(model, gravity=still)
debris = pinred.Model("debris").body("debris", mass=25.0, inertia=[2.0, 3.0, 4.0])
debris = debris.fixed("handle", parent="debris", at=(-0.4, 0.1, 0.0), attitude=(0.2, 0.0, 0.5))
target = pinred.load(debris, gravity=still)


def place(motion: pinred.Trajectory, link: str) -> pin.SE3:
    """Return the placement of a link in the world at the end of a motion."""
    frames, data = motion.system.model, motion.system.model.createData()
    pin.framesForwardKinematics(frames, data, motion.q[-1])
    return data.oMf[frames.getFrameId(link, pin.FrameType.BODY)]


# %% [markdown]
# ## Approach
# The body tumbles about all its axes. The arm swings out while the satellite has no momentum, so
# its base turns back. Where must the satellite start, so that its grip meets the handle at 4 s? It
# moves alike from every pose: this is its symmetry. One run from anywhere tells where its grip
# ends; the start moves by the difference.

# %%
tumbling = pinred.simulate(target, xi0=[0.02, -0.01, 0.03, 0.15, 0.30, -0.20], duration=4.0)
swing = {"shoulder": "0.5*(1-cos(pi*t/4))", "elbow": "-0.3*(1-cos(pi*t/4))"}
trial = pinred.simulate(
    chaser, x0=[0.0] * 5, prescribed=swing, hold="others", momentum=0, duration=4.0
)
shift = place(tumbling, "handle") * place(trial, "grip").inverse()
approach = pinred.simulate(trial.scene, pose0=pin.SE3ToXYZQUAT(shift))
turned = chaser.group.error(approach.pose[0], approach.pose[-1]).rotation
print(f"the swing of the arm turned the satellite by {turned:.4f} rad")
np.testing.assert_allclose(approach.x, trial.x, atol=1e-12)

# %% [markdown]
# ## Capture
# `capture` joins the links grip and handle. The result has the joined robot, its state, and the
# balances. The sum of the momenta is that before, to the last digits.

# %%
capture = pinred.capture(approach, tumbling, at="grip", onto="handle", tolerance=1e-9)
print(capture)
np.testing.assert_allclose(capture.momentum, capture.momentum_before, atol=1e-13)

# %% [markdown]
# Carnot's theorem gives the loss without the impulse: it is the energy of the lost velocities.

# %%
red = pinred.Reduction(capture.system)
state = capture.instant
after = red.split(state.x).kinetic_energy(state.xdot, state.xi)
print(f"energy before {capture.energy_before:.4f} J, after {after:.4f} J")
np.testing.assert_allclose(capture.energy_before - after, capture.energy_lost, atol=1e-12)

# %% [markdown]
# ## Detumbling
# Springs and dampers hold the arm. Each wheel is driven by the rate of the bus about its axis. The
# wheels cannot remove angular momentum: they take it up.


# %%
def damping(s: SeenState) -> dict[str, object]:
    """Return the torques of the wheels, proportional to the rates of the bus."""
    return {f"wheel_{axis}": 8.0 * s.xi[3 + k] for k, axis in enumerate("xyz")}


caught_at = dict(zip(capture.system.shape_names, state.x.tolist(), strict=True))
springs = [Spring(name, 200.0, caught_at[name]) for name in ("shoulder", "elbow")]
dampers = [Damper(name, 60.0) for name in ("shoulder", "elbow")]
forces = [Torque(damping, name="wheels"), *springs, *dampers]
detumbling = pinred.simulate(capture.system, **capture.start, forces=forces, duration=60.0)
rates = np.linalg.norm(detumbling.xi[:, 3:], axis=1)
print(f"rotation of the bus: {rates[0]:.4f} rad/s after the capture, {rates[-1]:.1e} at the end")
assert rates[-1] < 1e-3 * rates[0]

# %% [markdown]
# At the end, all angular momentum is in the wheels: their spins times 0.08 kg m².

# %%
end, joined = detumbling(60.0), capture.system.model
data = joined.createData()
pin.computeCentroidalMomentum(joined, data, end.q, end.v)
total = pin.Quaternion(end.pose[3:]).matrix().T @ data.hg.angular
wheels = [capture.system.shape_names.index(f"wheel_{axis}") for axis in "xyz"]
print("angular momentum:", total, "N m s, in the wheels:", 0.08 * end.xdot[wheels], "N m s")
np.testing.assert_allclose(0.08 * end.xdot[wheels], total, atol=5e-3)

# %% [markdown]
# ## The whole motion
# A chain is one motion of both robots: it plots, plays and saves. `compare` repeats each motion by
# ABA, and the capture by the full mass matrices.

# %%
chain = pinred.chain([approach, tumbling], capture, detumbling)
report = pinred.compare(chain)
print(report.impacts[0])
assert report
figure = pinred.plot(chain, "energy")
