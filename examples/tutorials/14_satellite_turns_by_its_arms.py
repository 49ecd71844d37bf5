# %% [markdown]
# # 14. A satellite turns by its arms
#
# Tutorial 5 computed by hand how large a loop must be for a quarter turn. `reorient` finds the
# motion for any target: the joints follow one loop n times, from rest to rest. The phase of the
# loop is the n-th root of the target, exp(w) = (exp(w/n))ⁿ. There are no thrusters and no wheels,
# and momentum is zero.

# %%
from importlib.util import find_spec

import numpy as np
import pinocchio as pin

import pinred

drawing = find_spec("matplotlib") is not None  # figures need the extra `plots`
satellite = pinred.load("satellite_two_arms")
SE3 = satellite.group

# %% [markdown]
# ## A first loop, from the curvature
# A small loop with the area bivector S moves the base by exp(−Σ B_ab S_ab), a < b. Among all S with
# the requested rotation, the smallest is nearly an ellipse. The optimiser starts there; Newton
# steps reduce the error to round-off.

# %%
quarter = np.array([0.0, 0.0, np.pi / 2])
plan = pinred.reorient(satellite, quarter, limits=2.6)
print(plan)
np.testing.assert_allclose(plan.turned, quarter, atol=1e-9)

# %% [markdown]
# ## The motion
# The plan prescribes the joints; the base is free. Its final attitude is the target.

# %%
traj = plan.trajectory
rotation = np.degrees(SE3.log(traj.pose[-1])[3:])
print(f"in {plan.duration:g} s the bus turns by {rotation.round(6)} degrees")
print(f"missed by {plan.missed:.0e} rad")
np.testing.assert_allclose(plan.missed, 0.0, atol=1e-8)
np.testing.assert_allclose(traj.xdot[[0, -1]], 0.0, atol=1e-9)
np.testing.assert_allclose(traj.x[-1], traj.x[0], atol=1e-9)

# %% [markdown]
# ## Check by Pinocchio
# Angular momentum about the centre of mass, by Pinocchio, is zero throughout. The net work of the
# drives is zero, because all bodies are at rest again.

# %%
model, data = satellite.model, satellite.model.createData()
momenta = [
    np.abs(pin.computeCentroidalMomentum(model, data, q, v).vector).max()
    for q, v in zip(traj.q, traj.v, strict=True)
]
work = traj.energy_balance.work
print(f"momentum at most {max(momenta):.0e}; work up to {np.abs(work).max():.3f} J,", end=" ")
print(f"in the end {work[-1].sum():.0e} J")
np.testing.assert_allclose(momenta, 0.0, atol=1e-8)
np.testing.assert_allclose(work[-1].sum(), 0.0, atol=1e-7)

# %%
report = plan.report
print(report)
if not report.passed:
    raise SystemExit("the reduced motion is not that of the full simulation")

# %%
pinred.plot(traj, "base") if drawing else None
