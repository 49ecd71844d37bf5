# %% [markdown]
# # 1. What is reduced, and why: Elroy's beanie
#
# Two bodies spin on one axis: a body with moment of inertia I₁ = 2 kg·m², at the angle θ, and a
# propeller with I₂ = 1 kg·m² on its head, at the angle x from the body. A configuration is
# (θ, x), and the Lagrangian is
#
#     L = ½ I₁ θ̇² + ½ I₂ (θ̇ + ẋ)² − V(x)
#
# Turning everything by the same angle changes nothing: θ is not in L. This is the *symmetry*, and
# the group is G = SO(2). What is left of a configuration when θ is forgotten is the *shape* x.
# This tutorial does by hand what pinred does for any robot.

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
# I is the *locked inertia*, that of the whole with the joint frozen, and A the *mechanical
# connection*: with μ = 0 the body turns by −A dx when the propeller turns by dx. Put
# θ̇ = μ/I − A ẋ into the kinetic energy, and it falls into two parts that do not mix:
#
#     T = ½ M ẋ² + ½ μ²/I,     M = I₁ I₂/(I₁ + I₂)
#
# M is the *reduced metric*. pinred takes all three from Pinocchio's mass matrix.

# %%
x = [0.4]
split = red.at(x)
closed = {"I": I1 + I2, "A": I2 / (I1 + I2), "M": I1 * I2 / (I1 + I2)}
found = (split.locked_inertia, split.local_connection, split.reduced_metric)
print(f"{'':2} {'pinred':>12} {'by hand':>12}")
for (name, by_hand), matrix in zip(closed.items(), found, strict=True):
    print(f"{name:2} {matrix.item():12.9f} {by_hand:12.9f}")
    np.testing.assert_allclose(matrix.item(), by_hand, rtol=1e-12)

# %% [markdown]
# ## Reduce: the shape alone
# The second part of T is a constant, so the shape is a system of its own, M ẍ = −V′(x): one
# equation for two angles. With a spring, V = ½ k x², it swings at ω = √(k/M) = √(1.5 k), whatever
# the momentum. `explain` says what pinred does not integrate: 3 numbers are left, x with its
# momentum, and θ on the side (a full simulation has six: Pinocchio's q holds cosines and sines).

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
# The angle of the body follows by integrating θ̇ = μ/I − A ẋ. Over any time it turns by
#
#     Δθ = μ Δt/I − A Δx
#
# The first part, the *dynamic phase*, needs time and momentum. The second, the *geometric phase*,
# depends on the path of the shape only, not on how fast it is followed.

# %%
turned = traj.pose[:, 0] - traj.pose[0, 0]
phases = spin * traj.t / I - A * (traj.x[:, 0] - x0)
print(f"turned in three periods: {turned[-1]:.9f} rad, by hand {spin * 3 * period / I:.9f} rad")
np.testing.assert_allclose(turned, phases, atol=1e-8)

# %% [markdown]
# After whole periods the shape is back and the geometric phase is zero, as for every robot with
# one joint: the *curvature* dA is zero where there is only one direction to go. It takes two
# joints to come home turned by wriggling (tutorial 3), or a loop that cannot be shrunk to a
# point. The propeller has such a loop: a whole turn. It brings back the shape, but not the body.

# %%
loop = pinred.simulate(system, x0=[0.0], xdot0=[2 * np.pi], momentum=0, duration=1.0)
np.testing.assert_allclose(loop.x[-1], 2 * np.pi, rtol=1e-9)
print(f"one turn of the propeller turns the body by {loop.pose[-1, 0]:.9f} rad,")
print(f"by hand −2π I₂/(I₁ + I₂) =                  {-2 * np.pi * A:.9f} rad")
np.testing.assert_allclose(loop.pose[-1, 0], -2 * np.pi * A, rtol=1e-9)

# %% [markdown]
# ## Believe nothing
# `compare` simulates both angles by Pinocchio's ABA, which knows nothing of all this.

# %%
report = pinred.compare(traj)
print(report)
if not report.passed:
    raise SystemExit("the reduced motion is not that of the full simulation")

# %% [markdown]
# The shape swings in the potential; the body (`base`) drifts with the momentum and swings along.

# %%
pinred.plot(traj, "phase") if drawing else None

# %%
pinred.plot(traj, "base") if drawing else None
