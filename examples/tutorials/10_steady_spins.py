# %% [markdown]
# # 10. Which steady spin survives?
#
# Throw a book into the air: about its longest and its shortest axis it spins steadily, about the
# middle one it tumbles. A steady spin is a *relative equilibrium*: body twist ξ and shape are
# constant. At angular momentum J the steady spins are the critical points of the energy over all
# directions n of the momentum in the body,
#
#     U(n) = ½ J² nᵀ I⁻¹ n
#
# that is, the three principal axes. The second derivative of U and the eigenvalues of the
# linearised reduced equations determine their stability.

# %%
import numpy as np

import pinred

body = pinred.load("rigid_body")
I1, I2, I3 = 1.0, 2.0, 2.5
J = 2.0
spins = pinred.relative_equilibria(body, momentum=J)
print(spins)
np.testing.assert_allclose(
    [s.amended_potential for s in spins], 0.5 * J**2 / np.array([I3, I2, I1])
)

# %% [markdown]
# ## By hand
# Linearise Euler's equations about Ω on the middle axis: the other two rates grow like e^{λt} with
#
#     λ = Ω √((I₂ − I₁)(I₃ − I₂)/(I₁ I₃))
#
# About the other two axes the same formula gives an imaginary λ: the axis only oscillates.

# %%
stable, middle, other = spins
growth = J / I2 * np.sqrt((I2 - I1) * (I3 - I2) / (I1 * I3))
print(f"middle axis: grows by {middle.growth:.9f} 1/s, by hand {growth:.9f} 1/s")
np.testing.assert_allclose(middle.growth, growth, rtol=1e-12)
nod = J / I3 * np.sqrt((I3 - I1) * (I3 - I2) / (I1 * I2))
np.testing.assert_allclose(stable.frequencies, [nod], rtol=1e-12)
assert [s.verdict for s in spins] == ["stable", "unstable", "stable"]

# %% [markdown]
# ## By simulation
# `scene(0, …)` starts on the growing mode with an amplitude of 1e-6. The growth is measured as the
# distance of the body momentum from its steady value.

# %%
traj = pinred.simulate(middle.scene(0, amplitude=1e-6, duration=20.0))
away = np.linalg.norm(traj.body_momentum - middle.mu, axis=1)
inside = (away > 1e-5) & (away < 1e-2)
measured = np.polyfit(traj.t[inside], np.log(away[inside]), 1)[0]
print(f"measured in a simulation: {measured:.5f} 1/s; after 20 s it is off by {away[-1]:.1e}")
np.testing.assert_allclose(measured, growth, rtol=1e-3)
report = pinred.compare(traj)
print(report)
if not report.passed:
    raise SystemExit("the reduced motion is not that of the full simulation")

# %% [markdown]
# ## A wheel that stabilises the middle axis
# A satellite has three reaction wheels, whose constant momenta are set by `cyclic`. A rotor of
# momentum h on an axis of inertia I₂ acts as if that axis had the inertia λ = I₂ + h/Ω, and the
# spin is stable if (λ − I₁)(λ − I₃) > 0. The hinged panel is locked at zero. First find the axis of
# middle inertia; then spin up the wheel on it until the spin is stable.

# %%
satellite = pinred.load("reaction_wheel_satellite")
locked = {"panel_hinge": 0.0}
still = pinred.relative_equilibria(satellite, momentum=0.5, prescribed=locked)
axis = next(s for s in still if s.verdict == "unstable")
wheel = f"wheel_{'xyz'[int(np.argmax(np.abs(axis.direction)))]}"
print(f"without wheels: {len(still)} spins, unstable about {np.round(axis.direction, 3)}: {wheel}")
sign = np.sign(axis.direction[np.argmax(np.abs(axis.direction))])
for momentum in (0.0, 0.02, 0.04, 0.06, 0.08):
    spun = pinred.relative_equilibria(
        satellite, momentum=0.5, prescribed=locked, cyclic={wheel: sign * momentum}
    )
    near = max(spun, key=lambda s: float(s.direction @ axis.direction))
    print(f"wheel of {momentum:.2f} N m s: {near.verdict:9}, grows by {near.growth:.6f} 1/s")
assert near.verdict == "stable"

# %% [markdown]
# ## Three verdicts
# *Stable*: the second variation of the energy is definite, so the motion stays close for ever.
# *Unstable*: a growth rate exceeds its error. *Undecided*: the energy gives no bound, and the
# linearised flow only oscillates. Then the smallest damper decides, and `damped_growth` of each
# joint gives the sign. On the command line:
#
#     pinred equilibria reaction_wheel_satellite --momentum 0.5 --cyclic wheel_x=0.3
#
# prints the table, and `--play 0 --mode 0` shows a mode in the browser.
