# %% [markdown]
# # 4. A quadruped in flight: legs swing, the body turns
#
# Between take-off and landing only gravity acts on a legged robot. This has two consequences, and
# pinred integrates neither of them:
#
# - the centre of mass is in free fall, c(t) = c₀ + v₀ t + ½ g t², for any leg motion;
# - the angular momentum about it keeps its value at take-off. Here it is zero, so the shape
#   rotates the body by ξ = −A(x) ẋ, like the cat in tutorial 3.
#
# All four legs of solo12 move in the same way: the hips (HFE) swing, the knees (KFE) fold. The
# motion is then in the pitch plane, where rotations commute, and *Stokes' theorem is exact*: the
# net pitch of a loop is the integral of the curvature over the enclosed area. Needs the extra
# `robots`.

# %%
from importlib.util import find_spec

import numpy as np
import pinocchio as pin

import pinred
from pinred.signals import Constant, Fourier

drawing = find_spec("matplotlib") is not None  # figures need the extra `plots`
solo = pinred.load("solo12")
red, data = pinred.Reduction(solo), solo.model.createData()
hips, knees = (np.array([n.endswith(end) for n in solo.shape_names]) for end in ("HFE", "KFE"))
HIP, KNEE, SWING = 0.4, -1.4, 0.8  # centre of the loop, amplitude of the swing [rad]
take_off = np.array([0.5, 0.0, 2.0])  # velocity of the centre of mass [m/s]
flight = 2 * take_off[2] / 9.81  # until it has its initial height again [s]


def leap(fold: float) -> pinred.Trajectory:
    """Return a flight with one ellipse of hip and knee; fold: amplitude of the knees [rad]."""
    hip, knee = Fourier(HIP, [], [SWING], flight), Fourier(KNEE, [fold], [], flight)
    plan = {
        name: hip if hips[k] else knee if knees[k] else Constant(0.0)
        for k, name in enumerate(solo.shape_names)
    }
    # Zero angular momentum about the centre of mass: μ = (m v, c × m v) about the base.
    x0 = HIP * hips + (KNEE + fold) * knees
    com = red.split(x0).com
    mu = np.concatenate([solo.mass * take_off, np.cross(com, solo.mass * take_off)])
    return pinred.simulate(solo, x0=x0, momentum=mu, prescribed=plan, duration=flight)


# %% [markdown]
# ## What is conserved, by Pinocchio
# Both numbers come from Pinocchio's (q, v), which pinred reconstructs from the reduced motion.

# %%
traj = leap(fold=0.9)
path = [pin.centerOfMass(solo.model, data, q).copy() for q in traj.q]
fall = path[0] + np.outer(traj.t, take_off) + 0.5 * np.outer(traj.t**2, solo.gravity)
spin = [
    pin.computeCentroidalMomentum(solo.model, data, q, v).angular.copy()
    for q, v in zip(traj.q, traj.v, strict=True)
]
print(
    f"flight of {flight:.3f} s, {np.max(path, axis=0)[2] - path[0][2]:.4f} m high, by hand", end=" "
)
print(f"v²/2g = {take_off[2] ** 2 / (2 * 9.81):.4f} m")
print(f"centre of mass, largest distance from the parabola: {np.abs(path - fall).max():.0e} m")
print(f"angular momentum about it: at most {np.abs(spin).max():.0e} kg·m²/s")
np.testing.assert_allclose(path, fall, atol=1e-12)
np.testing.assert_allclose(spin, 0.0, atol=1e-12)

# %% [markdown]
# ## How far the body pitches
# For joints that move together along the directions e₁ (hips) and e₂ (knees), the curvature is
# B(e₁, e₂). Its pitch component is integrated over the ellipse: Gauss points along the radius,
# equally spaced points along the angle. The loop (sin, cos) is clockwise, so the sign is plus.


# %%
def curvature_inside(fold: float) -> float:
    """Return the integral of the pitch component of B(e₁, e₂) over the ellipse [rad]."""
    points, weights = np.polynomial.legendre.leggauss(12)
    radius, phi = 0.5 * (points + 1.0), 2 * np.pi * np.arange(48) / 48
    hip = HIP + SWING * np.outer(radius, np.sin(phi))
    knee = KNEE + fold * np.outer(radius, np.cos(phi))
    B = red.grid(hip[..., None] * hips + knee[..., None] * knees).curvature[..., 4, :, :]
    density = np.einsum("rpab,a,b->rp", B, 1.0 * hips, 1.0 * knees)
    area = SWING * fold * radius[:, None] * (0.5 * weights[:, None]) * (2 * np.pi / 48)
    return float(np.sum(density * area))


def pitch(traj: pinred.Trajectory) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return the pitch of the body over time, (T,) [rad]."""
    rotation = solo.group.compose(solo.group.inverse(traj.pose[:1]), traj.pose)
    return np.asarray(solo.group.log(rotation)[:, 4])


net, inside = pitch(traj)[-1], curvature_inside(0.9)
print(f"the body pitches by {np.degrees(net):.6f}°, Stokes says {np.degrees(inside):.6f}°")
np.testing.assert_allclose(net, inside, rtol=1e-4)

# %% [markdown]
# With locked knees the legs return along the same path. The loop encloses no area: the body pitches
# back and forth, and at landing it has its initial attitude. Purcell's scallop cannot swim for the
# same reason.

# %%
scallop = leap(fold=0.0)
nod = np.degrees(pitch(scallop))
print(f"without folding, it nods by up to {np.abs(nod).max():.3f}°, in the end by {nod[-1]:.0e}°")
np.testing.assert_allclose(nod[-1], 0.0, atol=1e-7)

# %%
report = pinred.compare(traj)
print(report)
if not report.passed:
    raise SystemExit("the reduced motion is not that of the full simulation")

# %% [markdown]
# `traj.play()` shows the motion; `traj.save_html("solo.html")` writes a page with the animation.

# %%
pinred.plot(traj, "base") if drawing else None
