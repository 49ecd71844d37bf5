"""Euler's rigid body, Montgomery's phase and Dzhanibekov's flips."""

from __future__ import annotations

import numpy as np
from scipy.integrate import quad
from scipy.spatial.transform import Rotation
from scipy.special import ellipkm1

from ..stress.closed_forms import euler_top
from .public_names import Event, load, rigid_body_phase, simulate
from .row import Numbers, numbers, row

MOMENTS = np.array([1.0, 2.0, 2.5])  # of the bundled robot rigid_body [kg m²]


@row(
    "euler-rates",
    "Euler's rigid body: angular velocity in the body after 20 s [rad/s]",
    "L. D. Landau, E. M. Lifshitz, Mechanics, §37",
    relative=1e-11,
)
def euler_rates() -> Numbers:
    """Compare Jacobi's elliptic functions with a simulation."""
    omega = np.array([0.5, 0.7, 1.6])
    rates, _ = euler_top(MOMENTS, omega, np.array([20.0]))
    traj = simulate(load("rigid_body"), xi0=omega, duration=20.0, rtol=1e-13, atol=1e-15)
    return numbers(rates[0], traj.xi[-1])


@row(
    "montgomery-phase",
    "Montgomery's phase: rotation about the momentum in one period, by formula and simulated [rad]",
    "R. Montgomery, Am. J. Phys. 59 (1991) 394",
    relative=1e-11,
)
def montgomery_phase() -> Numbers:
    """Compare 2ET/J − Λ, with Λ by quadrature, with both routes of pinred."""
    omega = np.array([0.5, 0.7, 1.6])
    a, b, c = MOMENTS
    J, energy2 = np.linalg.norm(MOMENTS * omega), MOMENTS @ omega**2
    low, outer = (energy2 / J**2 - 1.0 / c), (1.0 / a - 1.0 / c, 1.0 / b - 1.0 / c)

    def cosine(angle: float) -> float:
        stretch = outer[0] * np.cos(angle) ** 2 + outer[1] * np.sin(angle) ** 2
        return float(np.sqrt(1.0 - low / stretch))

    _, period = euler_top(MOMENTS, omega, np.zeros(1))
    solid = quad(lambda angle: 1.0 - cosine(angle), 0.0, 2.0 * np.pi, epsabs=1e-13)[0]
    turn = (energy2 * period / J - solid) % (2.0 * np.pi)
    body = load("rigid_body")
    by_formula = rigid_body_phase(body, omega)
    traj = simulate(body, xi0=omega, duration=period, rtol=1e-13, atol=1e-15)
    angle = Rotation.from_quat(traj.pose[-1]).as_rotvec() @ (MOMENTS * omega) / J
    return numbers([turn] * 2, np.mod([by_formula.angle, angle], 2.0 * np.pi))


@row(
    "dzhanibekov-flips",
    "Dzhanibekov's effect: time between two flips, from (0.01, 1, 0) rad/s [s]",
    "L. D. Landau, E. M. Lifshitz, Mechanics, §37; M. S. Ashbaugh, C. C. Chicone, R. H. Cushman, "
    "J. Dyn. Differ. Equ. 3 (1991) 67",
    relative=1e-9,
)
def dzhanibekov_flips() -> Numbers:
    """Compare half a period of the elliptic functions with the zeros of ω₂ in a simulation."""
    omega = np.array([1e-2, 1.0, 0.0])
    a, b, c = MOMENTS
    energy2, square = MOMENTS @ omega**2, MOMENTS**2 @ omega**2
    speed2 = (b - a) * (energy2 * c - square) / (a * b * c)
    rest = (c - a) * a * (b - a) * omega[0] ** 2 / ((b - a) * (energy2 * c - square))
    half = 2.0 * ellipkm1(rest) / np.sqrt(speed2)
    flip = Event(lambda _t, _x, _xdot, mu: mu[1], "flip")
    traj = simulate(
        load("rigid_body"), xi0=omega, duration=3.0 * half, rtol=1e-13, atol=1e-16, events=[flip]
    )
    times = traj.events["flip"].t
    return numbers(half, times[1] - times[0])


ROWS = (euler_rates, montgomery_phase, dzhanibekov_flips)
