# %% [markdown]
# # 11. The double spherical pendulum
#
# Two pendulums on universal joints, one attached to the other. Rotating everything about the
# vertical changes nothing, so the angular momentum J about it is constant, and the steady motions
# at J are the critical points of the amended potential on shapes (Marsden and Scheurle 1993):
#
#     V_J(x) = V(x) + J²/(2 I(x))

# %%
from importlib.util import find_spec

import numpy as np
import pinocchio as pin

import pinred

drawing = find_spec("matplotlib") is not None  # figures need the extra `plots`
pendulum = pinred.load("double_spherical_pendulum")
equilibria = pinred.relative_equilibria(pendulum, momentum=2.0)
print(equilibria)
verdicts = [equilibrium.verdict for equilibrium in equilibria]
assert [verdicts.count(v) for v in ("stable", "unstable", "undecided")] == [1, 12, 1]

# %% [markdown]
# Each row is one shape, although several coordinates describe it: rotating a universal joint by
# half a turn and the azimuth by half a turn gives the same rod positions.
#
# ## Are they steady?
# Pinocchio's forward dynamics, which does not use the reduction, gives zero acceleration at all of
# them.

# %%
largest = 0.0
for equilibrium in equilibria:
    q, v = pendulum.q([0.0], equilibrium.x), pendulum.v(equilibrium.xi, equilibrium.xdot)
    a = pin.aba(pendulum.model, pendulum.model.createData(), q, v, np.zeros(4))
    largest = max(largest, float(np.abs(a).max()) / float(v @ v))
print(f"largest acceleration by ABA, of the squared rates: {largest:.1e}")
np.testing.assert_allclose(largest, 0.0, atol=1e-11)

# %% [markdown]
# ## The stable one, and its modes
# Both rods point outward. The second variation is positive, so the motion stays close. The
# linearised reduced equations give three modes for three joints.

# %%
lowest = equilibria[0]
print(f"stable at x = {np.round(lowest.x, 6)}, turning at {lowest.xi[0]:.6f} rad/s")
print("frequencies", np.round(lowest.frequencies, 5), "rad/s")
np.testing.assert_allclose(lowest.frequencies, [4.16816, 5.13036, 8.30001], atol=5e-6)
traj = pinred.simulate(lowest.scene(0, amplitude=1e-4, duration=6.0))
mode = lowest.modes[0]
swing = np.real(mode.shape * np.exp(1j * mode.frequency * traj.t)[:, None])
off = np.abs((traj.x - lowest.x) / 1e-4 - swing).max()
print(f"a motion that begins on the first mode follows it to {off:.1e} of its amplitude")
np.testing.assert_allclose(off, 0.0, atol=1e-2)

# %% [markdown]
# ## The undecided one
# One shape has an indefinite energy and a spectrum on the imaginary axis: it oscillates, and
# neither energy nor growth decides. A damper does: a coefficient c at a joint makes it grow by c
# times

# %%
(undecided,) = (equilibrium for equilibrium in equilibria if equilibrium.verdict == "undecided")
for joint, growth in undecided.damped_growth.items():
    print(f"  {joint}: {growth:+.5f} 1/s per N m s/rad")
assert max(undecided.damped_growth.values()) > 0.0

# %% [markdown]
# ## Bifurcations
# As J grows, equilibria appear in pairs at *folds*, or branch off a symmetric one at *pitchforks*.
# The first pair branches off the straight hanging pendulum where V_J loses a positive curvature, J²
# = −V″/(½ (1/I)″) in some direction: the smallest eigenvalue by differences of I and V.

# %%
branches = pinred.branches(pendulum, momentum=(0.155, 0.24), starts=40, step=0.2)
print(branches)
red, h = pinred.Reduction(pendulum), 1e-3


def second(f: object) -> np.ndarray:
    """Return second differences about the straight hanging shape."""
    assert callable(f)
    e = h * np.eye(3)
    return np.array([[
        f(a + b) - f(a - b) - f(b - a) + f(-a - b) for a in e] for b in e
    ]) / (4 * h**2)  # fmt: skip


stiffness = second(red.potential)
softening = second(lambda x: 0.5 / red.locked_inertia(x)[0, 0])
squares = -1.0 / np.linalg.eigvals(np.linalg.solve(stiffness, softening)).real
critical = np.sqrt(np.sort(squares))
hanging = [p.momentum for p in branches.pitchforks if p.amended_potential < -20.0]
print("pitchforks of the hanging one:", np.sort(hanging), " by differences:", critical)
np.testing.assert_allclose(np.sort(hanging), critical[: len(hanging)], rtol=1e-4)
assert len(hanging) == 2

# %%
pinred.plot(branches, "branches") if drawing else None
