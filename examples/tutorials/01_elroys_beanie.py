# %% [markdown]
# # 1. What is reduced, and why: Elroy's beanie
#
# Two bodies spin on one axis: a body with moment of inertia I₁ = 2 kg·m², at the angle θ, and a
# propeller with I₂ = 1 kg·m² on its head, at the angle x from the body. A configuration is
# (θ, x), and the Lagrangian is
#
#     L = ½ I₁ θ̇² + ½ I₂ (θ̇ + ẋ)² − V(x)
#
# Rotating both bodies by the same angle changes nothing: θ does not appear in L. This is the
# *symmetry*, and the group is G = SO(2). The remaining coordinate is the *shape* x. This tutorial
# does by hand what pinred does for any robot.

# %%
from importlib.util import find_spec

import numpy as np

import pinred

drawing = find_spec("matplotlib") is not None  # figures need the extra `plots`
I1, I2 = 2.0, 1.0
system = pinred.load("elroys_beanie")
red = pinred.Reduction(system)
print(system)

# %% [markdown]
# ## Split the kinetic energy
# By Noether's theorem the symmetry conserves ∂L/∂θ̇, the angular momentum
#
#     μ = (I₁ + I₂) θ̇ + I₂ ẋ = I (θ̇ + A ẋ),    I = I₁ + I₂,   A = I₂/(I₁ + I₂)
#
# I is the *locked inertia*, the inertia of the system with the joint locked. A is the *mechanical
# connection*: at μ = 0 the body rotates by −A dx when the propeller rotates by dx. With θ̇ = μ/I −
# A ẋ the kinetic energy is a sum of two decoupled terms:
#
#     T = ½ M ẋ² + ½ μ²/I,     M = I₁ I₂/(I₁ + I₂)
#
# M is the *reduced metric*. pinred takes all three from Pinocchio's mass matrix.

# %%
x = [0.4]
split = red.at(x)
closed = {"I": I1 + I2, "A": I2 / (I1 + I2), "M": I1 * I2 / (I1 + I2)}
pinred_values = (split.locked_inertia, split.local_connection, split.reduced_metric)
print(f"{'':2} {'pinred':>12} {'by hand':>12}")
for (name, by_hand), matrix in zip(closed.items(), pinred_values, strict=True):
    print(f"{name:2} {matrix.item():12.9f} {by_hand:12.9f}")
    np.testing.assert_allclose(matrix.item(), by_hand, rtol=1e-12)

# %% [markdown]
# ## Reduce: the shape alone
# The second term of T is constant, so the shape obeys a separate equation, M ẍ = −V′(x). With a
# spring, V = ½ k x², it oscillates at ω = √(k/M) = √(1.5 k) for any momentum. `explain` lists what
# pinred integrates: x, its momentum, and θ as a quadrature. A full simulation has six variables,
# because Pinocchio's q contains cosines and sines.

# %%
k, x0, spin = 6.0, 0.5, 0.7
omega, I, A = np.sqrt(1.5 * k), closed["I"], closed["A"]
period = 2 * np.pi / omega
traj = pinred.simulate(
    system,
    x0=[x0],
    momentum=[spin],
    duration=3 * period,
    springs={"beanie": (k, 0.0)},
    explain=True,
)
by_hand = x0 * np.cos(omega * traj.t)
print(f"shape, largest difference from x0 cos(ωt): {np.abs(traj.x[:, 0] - by_hand).max():.1e} rad")
np.testing.assert_allclose(traj.x[:, 0], by_hand, atol=1e-8)

# %% [markdown]
# ## Reconstruct: put the base back
# The angle of the body follows by integrating θ̇ = μ/I − A ẋ. In a time Δt it changes by
#
#     Δθ = μ Δt/I − A Δx
#
# The first term, the *dynamic phase*, depends on time and momentum. The second, the *geometric
# phase*, depends only on the path of the shape, not on its speed.

# %%
body_angle = traj.pose[:, 0] - traj.pose[0, 0]
phases = spin * traj.t / I - A * (traj.x[:, 0] - x0)
print(f"turned in three periods: {body_angle[-1]:.9f} rad, by hand {spin * 3 * period / I:.9f} rad")
np.testing.assert_allclose(body_angle, phases, atol=1e-8)

# %% [markdown]
# After whole periods the shape is periodic and the geometric phase is zero, as for every robot with
# one joint: the *curvature* dA vanishes in one dimension. A net rotation needs two joints (tutorial
# 3), or a loop that cannot be contracted to a point. The propeller has such a loop: one full turn.
# It restores the shape, but not the body angle.

# %%
loop = pinred.simulate(system, x0=[0.0], xdot0=[2 * np.pi], momentum=0, duration=1.0)
np.testing.assert_allclose(loop.x[-1], 2 * np.pi, rtol=1e-9)
print(f"one turn of the propeller turns the body by {loop.pose[-1, 0]:.9f} rad,")
print(f"by hand −2π I₂/(I₁ + I₂) =                  {-2 * np.pi * A:.9f} rad")
np.testing.assert_allclose(loop.pose[-1, 0], -2 * np.pi * A, rtol=1e-9)

# %% [markdown]
# ## Check against a full simulation
# `compare` simulates both angles by Pinocchio's ABA, which does not use the reduction.

# %%
report = pinred.compare(traj)
print(report)
if not report.passed:
    raise SystemExit("the reduced motion is not that of the full simulation")

# %% [markdown]
# The shape oscillates in the potential. The body angle (`base`) drifts with the momentum and
# oscillates too.

# %%
pinred.plot(traj, "phase") if drawing else None

# %%
pinred.plot(traj, "base") if drawing else None
