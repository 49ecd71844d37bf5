# %% [markdown]
# # 6. Choosing an integrator
#
# The reduced equations of a cat with springs in its spine, spinning in space: what is the error of
# a method, what does it cost, and what does it do in the long run? Reduction changes the answer.
# The momentum is conserved exactly *whatever* the method does, since only the attitude and the
# shape are integrated, and μ = RᵀJ follows. So momentum proves nothing here. Judge by shape and
# attitude against the full simulation, and by the energy, which no method here keeps by itself.

# %%
from importlib.util import find_spec
from math import nan

import numpy as np

import pinred
from pinred import DOP853, RKMK4, AdaptiveGauss, Radau, plots
from pinred.bench import Point, WorkPrecision
from pinred.integrators.method import Method

drawing = find_spec("matplotlib") is not None  # figures need the extra `plots`
cat = pinred.load("falling_cat")
scene = pinred.Scene(system=cat, duration=1.0, springs=dict.fromkeys(cat.shape_names, (0.5, 0.0)))

# %% [markdown]
# ## The candidates
# - `DOP853`, Dormand and Prince's pair of order 8 with a step chosen by the estimated error: the
#   default. Give it the tolerance you need.
# - `RKMK4`, Munthe-Kaas's form of the classical Runge–Kutta method of order 4: a fixed step, in
#   which the attitude moves by exponentials of rotations, corrected by dexp⁻¹. Without that
#   correction, energy would still look like order 4, and the attitude would be of order 2.
#
# Each is a value with its claims (`order`, `adaptive`, `symplectic`). To try another, add a line.

# %%
METHODS: list[Method] = [
    *(DOP853(rtol=tol, atol=tol / 100) for tol in (1e-5, 1e-7, 1e-9)),
    *(RKMK4(step=0.04 / 2**k) for k in range(3)),
]


def knob(method: Method) -> float:
    """Return what makes a method more accurate when it gets smaller: a tolerance or a step."""
    return method.rtol if isinstance(method, DOP853 | AdaptiveGauss | Radau) else method.step


# %% [markdown]
# ## Error against cost
# `compare` integrates (q, v) by Pinocchio's ABA a hundred times more accurately than the scene's
# tolerance, by two methods, and reports how far a trajectory is from that. The errors below are
# the largest over 1 s. (Its verdict is about the scene's tolerance, so it is not asked here.)

# %%
print(f"{'method':8} {'knob':>8} {'evaluations':>11} {'shape [rad]':>11} {'attitude':>9} ", end="")
print(f"{'energy':>8} {'momentum':>8}")
points: list[Point] = []
for method in METHODS:
    traj = pinred.simulate(scene, method=method)
    report = pinred.compare(traj)
    apart = report.shape_error, report.rotation_error, report.position_error
    points.append(Point(method.name, knob(method), nan, nan, traj.run.evaluations, *apart))
    print(
        f"{method.name:8} {knob(method):8.0e} {traj.run.evaluations:11} {report.shape_error:11.1e} "
        f"{report.rotation_error:9.1e} {report.energy_drift:8.0e} {report.momentum_drift:8.0e}"
    )
    np.testing.assert_array_less(report.momentum_drift, 1e-13)  # even for the coarsest
    np.testing.assert_array_less(report.reference_error, 0.1 * points[-1].error)  # a fine ruler

# %% [markdown]
# A method with fixed steps shows its order when the step is halved: the error falls by 2^order. One
# with a tolerance shows that it does what it is told: the error follows the tolerance.

# %%
for claim in {method.name: method for method in METHODS}.values():
    error, size = np.log([(p.error, p.tolerance) for p in points if p.method == claim.name]).T
    measured = np.diff(error) / np.diff(size)
    expected = 1.0 if claim.adaptive else float(claim.order)
    print(f"{claim.name:8} error ~ knob^p with p = {measured.round(2)}, expected {expected:g}")
    np.testing.assert_allclose(measured[-1], expected, atol=0.35)

# %% [markdown]
# ## The long run
# Over many swings local errors add up. The energy tells without a reference: it is constant, and
# its drift is what a method does to a motion that is too long to be judged point by point. Here
# twice the time doubles it; a symplectic method (`symplectic`) would keep it bounded.

# %%
times = np.linspace(0.0, 100.0, 201)
for method in (DOP853(rtol=1e-6, atol=1e-8), DOP853(), RKMK4(step=0.02)):
    traj = pinred.simulate(scene, duration=times[-1], times=times, method=method)
    off = np.abs(traj.energy - traj.energy[0]) / traj.energy[0]
    by_50, by_100 = (part.max() for part in np.array_split(off, 2))
    print(
        f"{method.name:8} {knob(method):8.0e} {traj.run.evaluations:8} evaluations, relative drift "
        f"of energy {by_50:.1e} by 50 s, {by_100:.1e} by 100 s"
    )
    np.testing.assert_allclose(by_100 / by_50, 1.0 if method.symplectic else 2.0, atol=0.4)

# %% [markdown]
# ## So which?
# - To know where the cat is: `DOP853`. From an error of 1e-4 on it is the cheaper one, by far where
#   much is asked for, and its tolerance says what one gets.
# - A fixed step where something else needs one (a controller's clock, a filter, a learner).
# - Never trust one number: `compare` a short piece of the motion before believing the long one.

# %%
found = WorkPrecision(
    problem="falling_cat with springs",
    joints=cat.m,
    duration=scene.end,
    reference_error=report.reference_error,
    about={method.name: f"order {method.order}" for method in METHODS},
    points=tuple(points),
)
plots.work_precision(found, against="evaluations") if drawing else None
