"""Heavy tops on a pivot: Lagrange's and Kovalevskaya's."""

from __future__ import annotations

import numpy as np
from scipy.special import ellipk

from .public_names import Event, Model, linearise, load, simulate
from .row import Numbers, numbers, row

GRAVITY = 9.81  # [m/s²]
# Lagrange's top: transverse and axial moments about the pivot [kg m²], and m g l [N m].
I1, I3, PULL = 0.35, 0.05, GRAVITY * 0.5
LAGRANGE = Model("top").body("top", mass=1.0, inertia=[0.1, 0.1, 0.05], com=[0.0, 0.0, 0.5])
# Kovalevskaya's top: moments (2, 2, 1)/2 about the pivot, centre of mass on the first axis.
KOVALEVSKAYA = Model("top").body("top", mass=1.0, inertia=[1.0, 0.84, 0.34], com=[0.4, 0.0, 0.0])


@row(
    "lagrange-nutation",
    "Lagrange's top, released from 0.6 rad with a spin of 40 rad/s: period of nutation [s]",
    "H. Goldstein, Classical Mechanics, §5.7",
    relative=1e-10,
)
def lagrange_nutation() -> Numbers:
    """Compare a complete elliptic integral with the turning points of a simulation."""
    tilt, spin = 0.6, 40.0
    u0, a2, b = np.cos(tilt), (I3 * spin / I1) ** 2, 2.0 * PULL / I1
    middle = 0.5 * a2 / b
    u1, u2 = middle + np.array([-1.0, 1.0]) * np.sqrt(middle**2 - a2 * u0 / b + 1.0)
    period = 4.0 * ellipk((u0 - u1) / (u2 - u1)) / np.sqrt(b * (u2 - u1))

    def slope(s):  # type: ignore[no-untyped-def]  # rate of the cosine of the tilt
        x, y, z, w = (s.pose[k] for k in range(4))
        return 2.0 * (x * z - y * w) * s.xi[1] - 2.0 * (y * z + x * w) * s.xi[0]

    traj = simulate(
        load(LAGRANGE, group="SO3"), xi0=[0.0, 0.0, spin], duration=4.0 * period,
        pose0=[np.sin(tilt / 2.0), 0.0, 0.0, np.cos(tilt / 2.0)], rtol=1e-13, atol=1e-15,
        events=[Event(slope, "turning point")],
    )  # fmt: skip
    times = traj.events["turning point"].t
    return numbers(period, times[3] - times[1])


@row(
    "sleeping-top",
    "Lagrange's sleeping top at 0.9 of the critical spin: growth of a perturbation [1/s]",
    "J. E. Marsden, T. S. Ratiu, Introduction to Mechanics and Symmetry, §15.10",
    relative=1e-10,
)
def sleeping_top() -> Numbers:
    """Compare √(m g l/I₁ − (I₃ω/2I₁)²) with an eigenvalue of the linearised flow."""
    spin = 0.9 * np.sqrt(4.0 * PULL * I1) / I3
    growth = np.sqrt(PULL / I1 - (0.5 * I3 * spin / I1) ** 2)
    traj = simulate(load(LAGRANGE, group="SO3"), xi0=[0.0, 0.0, spin], duration=0.1)
    return numbers(growth, np.max(linearise(traj, 0.0).eigenvalues.real))


@row(
    "kovalevskaya-integral",
    "Kovalevskaya's top: the fourth integral after 10 s [1/s⁴]",
    "S. Kowalevski, Acta Math. 12 (1889) 177",
    relative=1e-10,
)
def kovalevskaya_integral() -> Numbers:
    """Compare |(ω₁ + iω₂)² − n (Γ₁ + iΓ₂)|² before and after a simulation."""
    n = GRAVITY * 0.4 / 0.5
    traj = simulate(
        load(KOVALEVSKAYA, group="SO3"), xi0=[0.7, -0.4, 1.1], duration=10.0,
        rtol=1e-13, atol=1e-15,
    )  # fmt: skip
    x, y, z, w = traj.pose.T
    up = 2.0 * (x * z - y * w) + 2.0j * (y * z + x * w)
    integral = np.abs((traj.xi[:, 0] + 1j * traj.xi[:, 1]) ** 2 - n * up) ** 2
    return numbers(integral[0], integral[-1])


ROWS = (lagrange_nutation, sleeping_top, kovalevskaya_integral)
