# %% [markdown]
# # 7. A cat in one formula
#
# Consider a cat of two equal halves, each axisymmetric about its spine. The joint lets the bend
# between them rotate about the spine, without twist of one half against the other. If the bend, of
# angle β, makes one revolution at zero angular momentum, the cat rolls by
#
#     2π (k c / (k c² + s²) − 1),   c = cos β/2,   s = sin β/2,   k = I_axial / I_transverse.
#
# This is the phase of a loop in shape space. pinred computes it from the mass matrix.

# %%
import warnings
from importlib.util import find_spec

import numpy as np
import pinocchio as pin
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

import pinred

drawing = find_spec("matplotlib") is not None  # figures need the extra `plots`
k = 0.25
half, position = pin.Inertia(1.0, np.zeros(3), np.diag([1.0, 1.0, k])), pin.SE3.Identity()
model = pin.Model()
model.gravity.setZero()
front = model.addJoint(0, pin.JointModelSpherical(), position, "front")
model.appendBodyToJoint(front, half, position)
last = front
for name, joint_type in (("a", pin.JointModelRX), ("b", pin.JointModelRY), ("c", pin.JointModelRZ)):
    last = model.addJoint(last, joint_type(), position, name)
model.appendBodyToJoint(last, half, position)
with warnings.catch_warnings():  # the links between the joints are massless on purpose
    warnings.simplefilter("ignore", pinred.ModelWarning)
    cat = pinred.load(model)
A = pinred.Connection.mechanical(cat)

# %% [markdown]
# ## The loop
# Without twist, the rear half is rotated by β about an axis (−sin φ, cos φ, 0), where φ makes one
# revolution. Three joints realise any rotation. Their angles form a smooth closed path, whose
# Fourier series defines a gait.


# %%
def bend_goes_round(beta: float, harmonics: int = 48) -> pinred.Gait:
    """Return the gait of one revolution of a bend β."""
    phi = 2.0 * np.pi * np.arange(4 * harmonics) / (4 * harmonics)
    axis = np.stack([-np.sin(phi), np.cos(phi), np.zeros_like(phi)], axis=1)
    x = Rotation.from_rotvec(beta * axis).as_euler("XYZ")
    modes = np.fft.rfft(x, axis=0)[: harmonics + 1] / len(phi)
    return pinred.Gait.fourier(modes[0].real, 2.0 * modes[1:].real, -2.0 * modes[1:].imag)


def formula(beta: float) -> float:
    """Return the roll by the formula."""
    c, s = np.cos(0.5 * beta), np.sin(0.5 * beta)
    return float(2.0 * np.pi * (k * c / (k * c**2 + s**2) - 1.0))


print(f"{'bend':>8} {'phase':>12} {'formula':>12} {'bound':>9}")
for degrees in (20.0, 40.0, 60.0, 80.0):
    p = pinred.phase(A, bend_goes_round(np.radians(degrees)))
    roll = abs((formula(np.radians(degrees)) + np.pi) % (2.0 * np.pi) - np.pi)
    print(f"{degrees:7.0f}° {p.screw.angle:12.9f} {roll:12.9f} {p.error.rotation:9.1e}")
    np.testing.assert_allclose(p.screw.angle, roll, atol=1e-9)

# %% [markdown]
# ## Half a turn
# Which bend rolls the cat by half a turn in one loop? By the formula, the one with k c/(k c² + s²)
# = ½. By the phase: a rotation by half a turn has a matrix of trace −1.


# %%
def short_of_half(beta: float) -> float:
    """Return the real part of the quaternion of the phase."""
    return float(pinred.phase(A, bend_goes_round(beta)).pose[3])


beta = brentq(short_of_half, 0.9, 1.2, xtol=1e-12)
print(f"bent by {np.degrees(beta):.5f}° it turns over; the formula gives {formula(beta):.9f} rad")
np.testing.assert_allclose(formula(beta), -np.pi, atol=1e-8)

# %% [markdown]
# ## Several cycles
# After n cycles the pose is the n-th power of the phase, without integration error.

# %%
p = pinred.phase(A, bend_goes_round(0.7))
angles = [np.linalg.norm(cat.group.log(p.cycles(n))) for n in (1, 2, 3)]
print("after 1, 2, 3 cycles, rad:", *np.round(angles, 6))

# %%
pinred.plot(p, "cycles", count=4) if drawing else None
