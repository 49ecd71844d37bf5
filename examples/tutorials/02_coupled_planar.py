# %% [markdown]
# # 2. Coupled planar bodies, by hand and by pinred
#
# Two bodies slide on a frictionless plane. The first has mass m₁ and moment of inertia I₁ about its
# centre of mass, which is the origin of its frame. The second, (m₂, I₂), is pinned at its centre of
# mass to the point (d, 0) of the first; x is the angle between them. The group is SE(2), the rigid
# motions of the plane: pose g = (p, θ), body twist ξ = (v₁, v₂, ω) in the first body's frame.
#
# The velocity of the pin is v + ω d e₂, so in terms of ξ and ẋ the kinetic energy is
#
#     T = ½ m₁ |v|² + ½ I₁ ω² + ½ m₂ (v₁² + (v₂ + d ω)²) + ½ I₂ (ω + ẋ)²
#
# Its matrix is H = [[I, IA], [AᵀI, M̃]], base rows first:

# %%
from importlib.util import find_spec

import numpy as np

import pinred

drawing = find_spec("matplotlib") is not None  # figures need the extra `plots`
m1, m2, d, I1, I2 = 3.0, 1.0, 0.5, 0.5, 0.25
m = m1 + m2
I = np.array([[m, 0, 0], [0, m, m2 * d], [0, m2 * d, I1 + I2 + m2 * d**2]])
IA = np.array([[0.0], [0.0], [I2]])
H = np.block([[I, IA], [IA.T, np.array([[I2]])]])

system = pinred.load("coupled_planar")
red = pinred.Reduction(system)
x = np.array([0.3])
split = red.at(x)
print(f"mass matrix by hand and by CRBA differ by {np.abs(split.mass_matrix - H).max():.1e}")
np.testing.assert_allclose(split.mass_matrix, H, atol=1e-14)

# %% [markdown]
# ## Connection and reduced metric
# Solve I A = (0, 0, I₂)ᵀ. With Δ = m (I₁ + I₂) + m₁ m₂ d² and m = m₁ + m₂,
#
#     A = (0, −I₂ m₂ d/Δ, I₂ m/Δ),    M = I₂ − Aᵀ I A = I₂ (I₁ m + m₁ m₂ d²)/Δ
#
# A determines the motion of the first body at zero momentum, ξ = −A ẋ. The body rotates by ω = −I₂
# m/Δ per unit of ẋ, about the common centre of mass.

# %%
delta = m * (I1 + I2) + m1 * m2 * d**2
A = np.array([0.0, -I2 * m2 * d / delta, I2 * m / delta])
M = I2 * (I1 * m + m1 * m2 * d**2) / delta
print("A by hand  ", A, "  by pinred", split.local_connection[:, 0])
print("M by hand  ", M, "  by pinred", split.reduced_metric.item())
np.testing.assert_allclose(split.local_connection[:, 0], A, atol=1e-15)
np.testing.assert_allclose(split.reduced_metric, M, rtol=1e-13)
zero = max(np.abs(dX).max() for dX in (split.dI, split.dA, split.dM, split.curvature))
print(f"largest entry of dI, dA, dM and B: {zero:g}")

# %% [markdown]
# No term depends on x, because the second body is pinned at its centre of mass. The joint is
# *cyclic*, and its momentum π = M ẋ + Aᵀ μ is constant, like that of a reaction wheel. With one
# joint the curvature is always zero.
#
# ## The equations of motion
# Lagrange–Poincaré, with the locked velocity Ω = ξ + A ẋ and the body momentum μ = I Ω:
#
#     d/dt(M ẋ) = −⟨μ, [Ω, A]⟩,        μ̇ = ad*_ξ μ
#
# All other terms contain dI, dM, B or V, which are zero. ad_ξ is the matrix below, and ad*_ξ its
# transpose. No torque acts on the second body, so both bodies rotate at constant rates: ẍ = 0 and
# ω̇ = 0.

# %%
xi, xdot = np.array([0.4, -0.7, 0.9]), np.array([1.2])
ad = np.array([[0, -xi[2], xi[1]], [xi[2], 0, -xi[0]], [0, 0, 0]])
omega = xi + A * xdot
mu = I @ omega
mudot = ad.T @ mu
terms = pinred.equations.lagrange_poincare(red, x, xdot, omega)
print(terms)
print("μ̇ by hand: ", mudot)
np.testing.assert_allclose(terms.momentum.total, mudot, atol=1e-14)
vdot = np.linalg.solve(H, np.append(mudot, 0.0))  # H (ξ̇, ẍ) = (μ̇, π̇), and π̇ = 0
print("(ξ̇, ẍ) =", vdot)
# The Euler–Poincaré equations on SE(2), derived by hand (docs/errata.md has their signs).
by_hand = [xi[1] * xi[2] + m2 * d / m * xi[2] ** 2, -xi[0] * xi[2], 0.0, 0.0]
np.testing.assert_allclose(vdot, by_hand, atol=1e-14)

# %% [markdown]
# ## Reconstruction
# The motion has a closed form. Both angles grow linearly. The centre of mass, at (m₂ d/m, 0) in the
# first body, moves along a straight line, and p = c(t) − R(θ) (m₂ d/m, 0).

# %%
traj = pinred.simulate(system, x0=x, xdot0=xdot, xi0=xi, duration=10.0)
t, theta, lever = traj.t, xi[2] * traj.t, m2 * d / m
direction = xi[0] * t + lever * (1 - np.cos(theta))
across = (xi[1] + lever * xi[2]) * t - lever * np.sin(theta)
exact = np.column_stack([direction, across, theta])
error = np.abs(traj.pose - exact).max(axis=0)
print(f"after {t[-1]:g} s: x = {traj.x[-1, 0]:.9f} rad, by hand {x[0] + xdot[0] * t[-1]:.9f} rad")
print(f"largest error of the pose: {error[:2].max():.1e} m, {error[2]:.1e} rad")
np.testing.assert_allclose(traj.pose, exact, atol=1e-9)
np.testing.assert_allclose(traj.x[:, 0], x + xdot * t, atol=1e-9)
report = pinred.compare(traj)
print(report)
if not report.passed:
    raise SystemExit("the reduced motion is not that of the full simulation")

# %%
pinred.plot(traj, "base") if drawing else None
