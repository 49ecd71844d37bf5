# %% [markdown]
# # 6. Choosing an integrator
#
# A cat with springs in its spine spins in space. Which integrator is accurate, cheap, and stable in
# the long run? Every method conserves momentum, because pinred integrates attitude and shape only
# and computes μ = RᵀJ. So compare shape and attitude with a full simulation, and check the energy,
# whose error only symplectic methods keep bounded.

# %%
from importlib.util import find_spec
from math import nan

import numpy as np

import pinred
from pinred import DOP853, RKMK4, Gauss, Radau, plots
from pinred.forces import Damper
from pinred.integrators.methods import EqualSteps, ErrorControl
from pinred.laboratory.bench import Point, WorkPrecision

drawing = find_spec("matplotlib") is not None  # figures need the extra `plots`
cat = pinred.load("falling_cat")
scene = pinred.Scene(system=cat, duration=1.0, springs=dict.fromkeys(cat.shape_names, (0.5, 0.0)))

# %% [markdown]
# ## The candidates
# - `DOP853`, Dormand and Prince's pair of order 8: the estimated error determines the step.
# - `RKMK4`, Munthe-Kaas's form of the classical Runge–Kutta method of order 4: a fixed step, in
#   which the attitude moves by exponentials of rotations, corrected by dexp⁻¹.
# - `Gauss`, collocation at Gauss's points with a fixed step: symplectic, of any even order. Order
#   2 is the midpoint rule. It evaluates several stages at once, so counts overstate its time.
#
# Each has the properties `order`, `adaptive` and `symplectic`. To try another, add a line.

# %%
METHODS: list[ErrorControl | EqualSteps] = [
    *(DOP853(rtol=tol, atol=tol / 100) for tol in (1e-5, 1e-7, 1e-9)),
    *(RKMK4(step=0.04 / 2**k) for k in range(3)),
    *(Gauss(step=0.04 / 2**k, order=order) for order in (2, 6) for k in range(3)),
]


def knob(method: ErrorControl | EqualSteps) -> float:
    """Return the tolerance or the step of a method."""
    return method.rtol if isinstance(method, ErrorControl) else method.step


# %% [markdown]
# ## Error against cost
# `compare` reports the largest distance from a reference: (q, v) by Pinocchio's ABA, computed by
# two methods at a hundredth of the tolerance.

# %%
print(f"{'method':8} {'knob':>8} {'evaluations':>11} {'shape [rad]':>11} {'attitude':>9} ", end="")
print(f"{'energy':>8} {'momentum':>8}")
points: list[Point] = []
for method in METHODS:
    traj = pinred.simulate(scene, method=method)
    report = pinred.compare(traj)
    distance = report.shape_error, report.rotation_error, report.position_error
    points.append(Point(method.name, knob(method), nan, nan, traj.run.evaluations, *distance))
    print(
        f"{method.name:8} {knob(method):8.0e} {traj.run.evaluations:11} {report.shape_error:11.1e} "
        f"{report.rotation_error:9.1e} {report.energy_drift:8.0e} {report.momentum_drift:8.0e}"
    )
    np.testing.assert_array_less(report.momentum_drift, 1e-13)  # even for the largest step
    np.testing.assert_array_less(report.reference_error, 0.1 * points[-1].error)  # accurate

# %% [markdown]
# Halving a step divides the error by 2^order; with a tolerance, the error is proportional to it.

# %%
for claim in {method.name: method for method in METHODS}.values():
    error, size = np.log([(p.error, p.tolerance) for p in points if p.method == claim.name]).T
    p, expected = np.diff(error) / np.diff(size), 1 if claim.adaptive else claim.order
    print(f"{claim.name:8} error ~ knob^p with p = {p.round(2)}, expected {expected}")
    np.testing.assert_allclose(p[-1], expected, atol=0.35)

# %% [markdown]
# ## The long run
# The energy needs no reference, so it also checks motions that are too long for `compare`. Doubling
# the time doubles the drift; symplectic methods keep it bounded.

# %%
times = np.linspace(0.0, 100.0, 201)
for method in (DOP853(1e-10, 1e-12), RKMK4(step=0.02), Gauss(step=0.02, order=2), Gauss(step=0.04)):
    traj = pinred.simulate(scene, duration=times[-1], times=times, method=method)
    off = np.abs(traj.energy - traj.energy[0]) / traj.energy[0]
    by_50, by_100 = (half.max() for half in np.array_split(off, 2))
    print(
        f"{method.name:8} {knob(method):8.0e} {traj.run.evaluations:8} evaluations, relative drift "
        f"of energy {by_50:.1e} by 50 s, {by_100:.1e} by 100 s"
    )
    np.testing.assert_allclose(by_100 / by_50, 1.0 if method.symplectic else 2.0, atol=0.4)

# %% [markdown]
# ## A stiff spine
# Stiff springs with dampers force an explicit method to take tiny steps long after the fast motion
# has decayed. `Radau` (order 5) resolves only the slow motion, by implicit steps.

# %%
springs = dict.fromkeys(cat.shape_names, (1000.0, 0.0))
forces = [Damper(joint, 100.0) for joint in cat.shape_names]
methods = (method_class(rtol=1e-6, atol=1e-8) for method_class in (DOP853, Radau))
stiff = [pinred.simulate(scene, springs=springs, forces=forces, method=m) for m in methods]
print("stiff:", ", ".join(f"{t.run.evaluations} evaluations of {t.run.method}" for t in stiff))
np.testing.assert_allclose(stiff[0].x, stiff[1].x, atol=1e-5)

# %% [markdown]
# ## Which method to choose
# - Usually `method="auto"`, the default: `DOP853`, or `AdaptiveGauss` (order 16) where tolerances
#   are tight and only the final state is reported. `explain=True` states the reason.
# - `Gauss` if the energy must not drift over a long time; `Radau` for stiff springs and dampers.
# - Validate a short segment of the motion with `compare` before you trust the long one.

# %%
about = {method.name: f"order {method.order}" for method in METHODS}
result = WorkPrecision("springs", cat.m, scene.end, report.reference_error, about, tuple(points))
plots.work_precision(result, against="evaluations") if drawing else None
