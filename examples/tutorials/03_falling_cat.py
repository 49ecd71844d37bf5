# %% [markdown]
# # 3. The falling cat: turning without angular momentum
#
# A cat dropped upside down lands on its feet, although its angular momentum is zero throughout. It
# bends its spine and moves the bend around the spine: a closed loop in shape space. Zero momentum
# means Ω = 0, that is ξ = −A(x) ẋ: every change of shape rotates the body, and the rotation depends
# on the path. The net rotation after a closed loop is the *holonomy* or geometric phase of the
# loop. It is nonzero because the connection A has *curvature*, a 2-form on shape space:
#
#     B_αβ = ∂_αA_β − ∂_βA_α − [A_α, A_β]
#
# The robot is the model of Kane and Scher: a front and a back half, joined by `bend`, `sway` and
# `twist`.

# %%
from functools import reduce
from importlib.util import find_spec

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.optimize import brentq

import pinred
from pinred.signals import Constant, Fourier

drawing = find_spec("matplotlib") is not None  # figures need the extra `plots`
Vector = NDArray[np.float64]
cat = pinred.load("falling_cat")
red, SE3, data = pinred.Reduction(cat), cat.group, cat.model.createData()


def roll_the_bend(radius: float, seconds: float = 1.0, turn: int = 1) -> pinred.Trajectory:
    """Return the motion of one circle of (bend, sway) at zero momentum."""
    plan = {
        "bend": Fourier(0.0, [radius], [], seconds),  # radius · cos(2πt/seconds)
        "sway": Fourier(0.0, [], [turn * radius], seconds),  # radius · sin(2πt/seconds)
        "twist": Constant(0.0),
    }
    x0 = np.zeros(cat.m)  # overridden by the prescribed joints
    return pinred.simulate(cat, x0=x0, momentum=0, prescribed=plan, duration=seconds)


def turned(traj: pinred.Trajectory) -> Vector:
    """Return the rotation of the front half, as a vector in its initial frame [rad]."""
    return SE3.log(SE3.compose(SE3.inverse(traj.pose[0]), traj.pose[-1]))[3:]


# %% [markdown]
# ## Small loops measure the curvature
# A small loop rotates the body by minus the curvature times its area, −B π r². The next term is of
# order r³, because the loop starts at its rim and rotations do not commute.

# %%
B = red.curvature([0.0, 0.0, 0.0])[3:, 0, 1]
print(f"{'radius [rad]':>12} {'turned [rad]':>13} {'|B| πr² [rad]':>14} {'difference':>11}")
off = []
for radius in (0.2, 0.1, 0.05):
    angle, flat = turned(roll_the_bend(radius)), -B * np.pi * radius**2
    off.append(np.linalg.norm(angle - flat) / np.linalg.norm(flat))
    print(
        f"{radius:12g} {np.linalg.norm(angle):13.8f} {np.linalg.norm(flat):14.8f} {off[-1]:10.2%}"
    )
np.testing.assert_allclose(np.divide(off[:-1], off[1:]), 2.0, rtol=0.05)  # half the error

# %% [markdown]
# ## Large loops by hand
# Along a path the pose is the ordered product of small steps, g ← g · exp(−A(x) Δx). It needs the
# connection and the path, but neither time nor equations of motion.


# %%
def holonomy(radius: float, steps: int = 2000) -> Vector:
    """Return the ordered product over the circle, an element of SE(3)."""
    phi = 2 * np.pi * np.arange(2 * steps + 1) / (2 * steps)
    circle = radius * np.column_stack([np.cos(phi), np.sin(phi), 0 * phi])
    A = red.grid(circle[1::2]).local_connection  # at the midpoint of each step
    twists = -A @ np.diff(circle[::2], axis=0)[..., None]
    return reduce(SE3.compose, SE3.exp(twists[..., 0]))


traj, product = roll_the_bend(1.2), SE3.log(holonomy(1.2))[3:]
print("simulated:      ", turned(traj).round(6), "rad")
print("ordered product:", product.round(6), "rad")
np.testing.assert_allclose(turned(traj), product, atol=1e-5)

# %% [markdown]
# ## The phase is geometric
# At three times the speed, the cat rotates by the same angle. On the reversed path it rotates back.
# The axis is in the plane of the arch, along the cat from tail to head: the cat rolls.

# %%
fast, back = roll_the_bend(1.2, seconds=0.3), roll_the_bend(1.2, turn=-1)
for name, motion in {"in 1 s": traj, "in 0.3 s": fast, "backwards": back}.items():
    momenta = [
        pin.computeCentroidalMomentum(cat.model, data, q, v).angular.copy()
        for q, v in zip(motion.q, motion.v, strict=True)
    ]
    print(f"{name:9} {np.linalg.norm(turned(motion)):.9f} rad", end="; ")
    print(f"angular momentum by Pinocchio at most {np.abs(momenta).max():.0e} kg·m²/s")
np.testing.assert_allclose(turned(fast), turned(traj), atol=1e-8)
np.testing.assert_allclose(turned(back), -turned(traj), atol=1e-8)

# %% [markdown]
# ## Land on your feet
# How far must the cat bend to rotate by half a turn in one loop? The ordered product gives the
# bend. Pinocchio's ABA, which uses no connection, validates the motion. `fall.play()` shows it.

# %%
half_turn = brentq(lambda r: holonomy(r, 300)[6], 1.0, 1.55)  # where cos(angle/2) is zero
fall = roll_the_bend(half_turn, seconds=0.5)
angle = np.degrees(np.linalg.norm(turned(fall)))
print(f"bent by {np.degrees(half_turn):.2f}°, the cat turns by {angle:.2f}° in one roll")
report = pinred.compare(fall)
print(report)
if not (report.passed and abs(angle - 180.0) < 0.1):
    raise SystemExit("the cat does not land on its feet")

# %%
pinred.plot(fall, "curvature", component="ω1") if drawing else None
