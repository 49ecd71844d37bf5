# %% [markdown]
# # 5. A satellite moves its arms and turns
#
# A satellite of 100 kg has two arms of three joints, without thrusters or wheels. Its momentum is
# zero and remains zero. Every arm motion moves the bus by ξ = −A(x) ẋ. Space robotics compensates
# this motion to reach a target (the generalised Jacobian of Umetani and Yoshida), or uses it to
# rotate the bus by loops of the arms, like the cat.

# %%
from importlib.util import find_spec

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.optimize import brentq

import pinred
from pinred.signals import Constant, Fourier

drawing = find_spec("matplotlib") is not None  # figures need the extra `plots`
satellite = pinred.load("satellite_two_arms")
red, SE3 = pinred.Reduction(satellite), satellite.group
print(satellite)

# %% [markdown]
# ## The generalised Jacobian
# The twist of the left hand's tip is V = J_b ξ + J_x ẋ, where J_b and J_x are the columns of
# Pinocchio's Jacobian for the base and the joints. At zero momentum ξ = −A ẋ, so
#
#     V = J* ẋ,    J* = J_x − J_b A
#
# J* depends on the masses, unlike the Jacobian J_x of an arm with a fixed base. Solve for the joint
# rates of the left arm with either Jacobian, and let Pinocchio compute the velocity of the tip.

# %%
model, x = satellite.model.copy(), np.array([0.3, -0.5, 0.4, -0.2, 0.6, 0.3])
at_tip = pin.SE3(np.eye(3), np.array([0.4, 0.0, 0.0]))  # placement: the hand is 0.4 m long
wrist = model.getJointId("left_wrist")
tip = model.addFrame(pin.Frame("tip", wrist, at_tip, pin.FrameType.OP_FRAME))
data, q = model.createData(), satellite.q(SE3.identity(), x)
J = pin.computeFrameJacobian(model, data, q, tip, pin.LOCAL)
Jb, Jx, A = J[:, :6], J[:, 6:], red.local_connection(x)
target, arm = np.array([0.1, -0.05, 0.08]), slice(0, 3)  # velocity in the frame of the tip [m/s]
errors = {}
for name, jacobian in (("fixed base", Jx), ("generalised", Jx - Jb @ A)):
    xdot = np.zeros(6)
    xdot[arm] = np.linalg.solve(jacobian[:3, arm], target)
    pin.forwardKinematics(model, data, q, satellite.v(-A @ xdot, xdot))
    reached = pin.getFrameVelocity(model, data, tip, pin.LOCAL).linear
    errors[name] = np.linalg.norm(reached - target) / np.linalg.norm(target)
    print(f"{name:11} Jacobian: wanted {target}, got {reached.round(6)} m/s")
print(f"wrong by {errors['fixed base']:.1%} and {errors['generalised']:.0e}")
np.testing.assert_allclose(errors["generalised"], 0.0, atol=1e-12)

# %% [markdown]
# ## A loop of one arm
# Shoulder and elbow of the left arm follow a circle n times; all other joints are locked.


# %%
def swing(radius: float, loops: int = 1, seconds: float = 4.0) -> pinred.Trajectory:
    """Return the motion of `loops` circles of the left arm; radius: [rad]."""
    plan: dict[str, pinred.signals.Signal] = dict.fromkeys(satellite.shape_names, Constant(0.0))
    plan["left_shoulder"] = Fourier(0.0, [radius], [], seconds)
    plan["left_elbow"] = Fourier(0.0, [], [radius], seconds)
    return pinred.simulate(
        satellite, x0=np.zeros(6), momentum=0, prescribed=plan, duration=loops * seconds
    )


def change(traj: pinred.Trajectory) -> NDArray[np.float64]:
    """Return the final pose relative to the initial one."""
    return SE3.compose(SE3.inverse(traj.pose[0]), traj.pose[-1])


once, thrice = change(swing(0.8)), change(swing(0.8, loops=3))
angle = np.degrees(SE3.log(once)[3:])
print("one loop turns the bus by", angle.round(6), "degrees about its axes")

# %% [markdown]
# Each loop rotates the bus by the same rotation, in the current frame of the bus. So the holonomy
# of n loops is the n-th power, g_n = g₁ⁿ, which is n times the angle about the same axis.

# %%
power = SE3.compose(SE3.compose(once, once), once)
delta = SE3.error(power, thrice)
print(f"three loops against the third power: {delta.rotation:.0e} rad, {delta.translation:.0e} m")
np.testing.assert_allclose([delta.rotation, delta.translation], 0.0, atol=1e-9)
np.testing.assert_allclose(np.degrees(SE3.log(thrice)[3:]), 3 * angle, atol=1e-6)

# %% [markdown]
# ## Turn by 90 degrees
# How large must the loop be for four of them to make a quarter turn? The angle of one loop grows
# with the radius, so bracket the radius and solve. Then compute the drive torques. After a whole
# loop the arm has its initial state: the net work of the drives is zero. `traj.play()` shows it.

# %%
quarter = brentq(lambda r: np.linalg.norm(SE3.log(change(swing(r)))[3:]) - np.pi / 8, 0.5, 1.2)
traj = swing(quarter, loops=4)
rotation = np.degrees(np.linalg.norm(SE3.log(change(traj))[3:]))
balance, torques = traj.energy_balance, np.abs(traj.driving_torques).max(axis=0)
print(f"four loops of radius {np.degrees(quarter):.3f}° turn the bus by {rotation:.6f}°")
most = int(torques.argmax())
print(f"largest torque of a drive: {torques[most]:.3f} N·m at {satellite.shape_names[most]}")
print(f"work of the drives: up to {np.abs(balance.work).max():.3f} J, in the end", end=" ")
print(
    f"{balance.work[-1].sum():.0e} J; energy unaccounted for {np.abs(balance.residual).max():.0e} J"
)
np.testing.assert_allclose(rotation, 90.0, atol=1e-6)
np.testing.assert_allclose(balance.work[-1].sum(), 0.0, atol=1e-8)

# %%
report = pinred.compare(traj)
print(report)
if not report.passed:
    raise SystemExit("the reduced motion is not that of the full simulation")

# %%
pinred.plot(traj, "base") if drawing else None
