# %% [markdown]
# # 13. The best stroke
#
# Three rods in a row float in the plane, with two joints. At zero momentum a loop of the joints
# rotates them by the integral of the curvature over the enclosed area. Which loop gives the largest
# rotation, and which the largest rotation per length? "Most per cycle" is defined only for loops
# that go round once: a series of H harmonics can go round H times.

# %%
from importlib.util import find_spec

import numpy as np

import pinred

drawing = find_spec("matplotlib") is not None  # figures need the extra `plots`
system = pinred.load("three_rods")
rods = pinred.Connection.mechanical(system)

# %% [markdown]
# ## The largest rotation
# The angular component of the curvature is odd, B(−α) = −B(α): one half of the square |α| ≤ 1
# rotates the rods to the left, the other to the right. So the best simple loop goes round one half,
# a triangle. A polygon in polar coordinates about a variable centre cannot intersect itself.

# %%
half = pinred.Gait.waypoints([[-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
whole_half = abs(pinred.phase(rods, half).pose[2])
largest = pinred.optimise_gait(rods, cost=None, vertices=24, limits=1.0, starts=2)
fraction = largest.value / whole_half
print(f"the triangle turns by {whole_half:.12f} rad, the polygon by {fraction:.6%} of that")
np.testing.assert_allclose(fraction, 1.0, atol=1e-4)
assert fraction <= 1.0

# %% [markdown]
# ## The largest rotation per length
# Length is measured in the reduced metric, ∫√(ẋᵀMẋ) dt. Each start is a random ellipse, which goes
# round once. Then harmonics are added, and finally the windings are counted.

# %%
best = pinred.optimise_gait(rods, objective="rotation", cost="length", harmonics=9, starts=2)
print(best)
np.testing.assert_allclose(best.merit, 2.38599, atol=6e-6)

# %% [markdown]
# ## No neighbouring loop is better
# The residual above proves this to first order. Slightly larger and smaller loops confirm it.

# %%
for factor in (0.9, 1.1):
    near = pinred.phase(rods, best.gait.scaled(factor))
    merit = abs(near.pose[2]) / near.length
    print(f"{factor} times as large: {merit:.5f} rad per length")
    assert merit < best.merit

# %% [markdown]
# ## Validation by ABA
# One cycle is simulated with joints prescribed on the loop; full ABA follows it with the resulting
# torques. The final pose of the base equals the phase.

# %%
difference = best.flow_error
print(f"flow against phase: {difference.rotation:.0e} rad, {difference.translation:.0e} m")
np.testing.assert_allclose([difference.rotation, difference.translation], 0.0, atol=1e-8)
report = best.report
print(report)
if not report.passed:
    raise SystemExit("the reduced motion is not that of the full simulation")

# %%
pinred.plot(best.trajectory, "shape") if drawing else None
