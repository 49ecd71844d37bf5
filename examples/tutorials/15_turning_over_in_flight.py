# %% [markdown]
# # 15. solo12 turns over in flight
#
# The robot leaps and is in free fall for 0.9 s. Its angular momentum is zero, so only the legs
# rotate the trunk: ξ = −A(x) ẋ. The legs swing about the hips (HAA) and fold such that the trunk
# rotates by half a turn and the feet point down again, from rest to rest, within limits, and as
# slowly as possible. The flow provides the final pose and its derivatives with respect to all knots
# of the joint curves to IPOPT. Needs the extra `robots`, and about ten seconds.

# %%
from typing import Any

import casadi as ca
import numpy as np
from scipy.interpolate import CubicSpline

import pinred
from pinred import Parameter
from pinred.signals import Spline

FLIGHT, KNOTS = 0.9, 7  # duration [s]; number of inner knots per curve
STAND = 0.7  # thigh angle when standing [rad]; the knee angle is −2 times this
SWING, FOLD, RATE = (-1.6, 5.0), (-0.1, 1.4), 30.0  # limits [rad], [rad], [rad/s]
solo = pinred.load("solo12")
times = np.linspace(0.0, FLIGHT, KNOTS + 2)

# %% [markdown]
# ## The plan, and the flow of its knots
# All legs swing by half a turn. They fold symmetrically, front and hind, left and right, so that
# the trunk neither pitches nor yaws. The variables of IPOPT are Parameters: one kernel serves all
# plans. `of=["pose"]` requests the derivatives of the pose.


# %%
def curve(name: str, begin: float, end: float) -> tuple[Spline, list[str]]:
    """Return a spline from rest to rest between two angles, and the names of its knots."""
    line = np.linspace(begin, end, KNOTS + 2)[1:-1]
    knots = [Parameter(f"{name} {k}", angle) for k, angle in enumerate(line)]
    return Spline(times, [begin, *knots, end], end="clamped"), [knot.name for knot in knots]


thigh, knee = STAND, -2.0 * STAND
curves = {"HAA": curve("swing", 0.0, np.pi)}
for name, angle in {"FHFE": thigh, "HHFE": -thigh, "FKFE": knee, "HKFE": -knee}.items():
    curves[name] = curve(name, angle, angle)
plan = {n: curves["HAA" if n.endswith("HAA") else n[0] + n[3:]][0] for n in solo.shape_names}
inputs = [name for _, names in curves.values() for name in names]
how: dict[str, Any] = {"duration": FLIGHT, "rtol": 1e-8, "method": "DOP853"}
flow = pinred.flow(solo, prescribed=plan, momentum=0, wrt=inputs, of=["pose"], **how)
motion = flow.casadi()  # must exist as long as the solver

# %% [markdown]
# ## The problem
# A spline is linear in its knots, and so are the limits, imposed at 61 times. Half a turn of the
# trunk is one equation: the real part of its final quaternion is zero.

# %%
swing, fold = ca.MX.sym("swing", KNOTS), ca.MX.sym("fold", KNOTS)
knot_values = ca.vertcat(swing, fold, -fold, -2.0 * fold, 2.0 * fold)
attitude = motion(*ca.vertsplit(knot_values))[3:]
fine = np.linspace(0.0, FLIGHT, 61)
units = [CubicSpline(times, unit, bc_type="clamped") for unit in np.eye(KNOTS + 2)]
at, rate = (ca.DM(np.transpose([unit(fine, order) for unit in units])) for order in (0, 1))
swings, folds = ca.vertcat(0.0, swing, np.pi), ca.vertcat(STAND, fold, STAND)
limited: list[tuple[Any, float, float]] = [
    (attitude[3], 0.0, 0.0),
    (at @ swings, *SWING),
    (at @ folds, *FOLD),
    (rate @ swings, -RATE, RATE),
    (2.0 * rate @ folds, -RATE, RATE),  # the knees are faster than the thighs
]
cost = (ca.sumsqr(rate @ swings) + 5.0 * ca.sumsqr(rate @ folds)) / len(fine)
x = ca.vertcat(swing, fold)
problem: Any = {"x": x, "f": cost, "g": ca.vertcat(*(bound[0] for bound in limited))}
low, high = (np.hstack([np.full(bound[0].numel(), bound[k]) for bound in limited]) for k in (1, 2))
options = {"hessian_approximation": "limited-memory", "tol": 1e-4, "print_level": 0, "sb": "yes"}
settings: Any = {"ipopt": options, "print_time": False}
solver = ca.nlpsol("solver", "ipopt", problem, settings)
fraction = times[1:-1] / FLIGHT
guess = [
    np.pi * fraction + np.sin(np.pi * fraction) ** 2,
    STAND - 0.5 * np.sin(2.0 * np.pi * fraction),
]
solution = solver(x0=np.concatenate(guess), lbg=low, ubg=high)
print(solver.stats()["return_status"], "after", solver.stats()["iter_count"], "iterations")

# %% [markdown]
# ## The flight
# The same scene with the optimal knots and a leap: the centre of mass is in free fall, which does
# not affect the rotation.

# %%
numbers = np.array(ca.Function("knot_values", [x], [knot_values])(solution["x"]))[:, 0]
com = pinred.Reduction(solo).split(np.array([plan[n].value(0.0) for n in solo.shape_names])).com
push = solo.mass * np.array([0.0, 0.0, 0.5 * 9.81 * FLIGHT])
traj = pinred.simulate(
    flow.scene,
    parameters=dict(zip(inputs, numbers, strict=True)),
    momentum=np.concatenate([push, np.cross(com, push)]),  # zero about the centre of mass
    times=fine,
)
rotation = np.degrees(solo.group.error(traj.pose[0], traj.pose[-1]).rotation)
print(f"the trunk turns by {rotation:.4f} degrees; off the long axis: {traj.pose[-1, 4:6]}")
print(f"swing from {traj.x[:, 0].min():.2f} to {traj.x[:, 0].max():.2f} rad", end=", ")
print(f"fold from {traj.x[:, 1].min():.2f} to {traj.x[:, 1].max():.2f} rad", end=", ")
print(f"rates up to {np.abs(traj.xdot).max():.1f} rad/s")
print(f"torques of the drives up to {np.abs(traj.driving_torques).max():.2f} N m")
np.testing.assert_allclose(rotation, 180.0, atol=1e-3)
np.testing.assert_allclose(traj.xdot[[0, -1]], 0.0, atol=1e-9)
report = pinred.compare(traj)
print(report)
assert report.passed
