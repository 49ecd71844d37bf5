# %% [markdown]
# # 9. A hand that stays put
#
# An arm on a free-floating spacecraft moves its base. At zero momentum the hand moves with J_g ẋ,
# where J_g = J_s − J_b A is the *generalised Jacobian*; nonzero momentum adds a drift. The planar
# arm is that of Papadopoulos and Dubowsky.

# %%
from importlib.util import find_spec

import numpy as np
from numpy.typing import NDArray

import pinred
from pinred.equations import lagrange_poincare
from pinred.forces import Controller

drawing = find_spec("matplotlib") is not None  # figures need the extra `plots`
Vector = NDArray[np.float64]
system = pinred.load("floating_arm")
red, arm = pinred.Reduction(system), pinred.FloatingArm(system, "hand")
x0, spin = np.array([0.9, -1.6]), np.array([0.0, 0.0, 1.5])  # kg m²/s


def hand(traj: pinred.Trajectory) -> Vector:
    """Return the path of the hand, (T, 2)."""
    poses = (arm.hand_pose(x, pose=g) for x, g in zip(traj.x, traj.pose, strict=True))
    return np.array([pose.translation[:2] for pose in poses])


# %% [markdown]
# ## The drift
# With locked joints, a rotating spacecraft carries the hand along.

# %%
frozen = pinred.simulate(
    system, x0=x0, xdot0=[0.0, 0.0], momentum=spin, duration=6.0,
    prescribed={"q1": x0[0], "q2": x0[1]},
)  # fmt: skip
way = float(np.linalg.norm(hand(frozen) - hand(frozen)[0], axis=1).max())
print(f"with frozen joints the hand strays by {way:.3f} m")

# %% [markdown]
# ## Resolved rates in a control loop
# The joint rates −J_g⁻¹ times the drift cancel it. A controller at 200 Hz commands these rates. It
# measures shape and body momentum, but no attitude.


# %%
def hold(t: float, x: Vector, xdot: Vector, mu: Vector) -> Vector:  # noqa: ARG001
    """Return torques that control the joint rates such that the hand is at rest."""
    target = np.linalg.solve(arm.generalized_jacobian(x)[:2], -arm.drift(x, mu)[:2])
    return np.asarray(red.reduced_metric(x) @ (target - xdot) / 0.02)


start = np.linalg.solve(arm.generalized_jacobian(x0)[:2], -arm.drift(x0, spin)[:2])
controlled = pinred.simulate(
    system, x0=x0, xdot0=start, momentum=spin, duration=6.0,
    forces=[Controller(hold, period=0.005)],
)  # fmt: skip
strays = float(np.linalg.norm(hand(controlled) - hand(controlled)[0], axis=1).max())
rotation = float(np.degrees(controlled.pose[-1, 2] - controlled.pose[0, 2]))
print(f"held, it strays by {strays:.4f} m while the spacecraft turns by {rotation:.1f}°")
np.testing.assert_array_less(strays, 0.01 * way)

# %% [markdown]
# ## Resolved accelerations
# At zero momentum V̇ = J_g ẍ + J̇_g ẋ for the velocity V of the hand in its own axes. Torques from
# this equation make the hand follow a requested velocity, exactly up to the sampling.


# %%
def speed(t: float) -> Vector:
    """Return the requested velocity of the hand in its own axes [m/s]."""
    return np.array([0.0, 0.12 * np.sin(np.pi * t / 3.0) ** 2])


def steer(t: float, x: Vector, xdot: Vector, mu: Vector) -> Vector:  # noqa: ARG001
    """Return torques by the reduced dynamics."""
    J, rate = arm.generalized_jacobian(x)[:2], arm.rate(x, xdot)[:2]
    change = (speed(t + 1e-4) - speed(t - 1e-4)) / 2e-4
    target = change + 20.0 * (speed(t) - J @ xdot)
    free = lagrange_poincare(red, x, xdot, np.zeros(3)).xddot
    return np.asarray(red.reduced_metric(x) @ (np.linalg.solve(J, target - rate @ xdot) - free))


steered = pinred.simulate(
    system, x0=x0, xdot0=[0.0, 0.0], momentum=0, duration=3.0,
    forces=[Controller(steer, period=0.005)],
)  # fmt: skip
V = np.array(
    [arm.generalized_jacobian(x)[:2] @ v for x, v in zip(steered.x, steered.xdot, strict=True)]
)
asked = np.array([speed(t) for t in steered.t])
print(f"the hand's velocity is off by {np.abs(V - asked).max():.1e} m/s at most")
np.testing.assert_allclose(V, asked, atol=2e-3)
print(pinred.compare(steered))

# %%
pinred.plot(controlled, "shape") if drawing else None
