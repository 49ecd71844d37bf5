"""Motions of free bodies, and turns of the body by motions of its joints.

Bodies are tops, planar bodies and spherical pendulums. Cats, a hopper, a diver and arms of
satellites turn at zero momentum.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import cache
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.linalg import eigvals
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from scipy.special import ellipk, ellipkm1

from ...analysis.connections.connection import Connection
from ...analysis.equilibria.find_equilibria import relative_equilibria
from ...analysis.equilibria.relative_equilibrium import Equilibria
from ...analysis.floating_arm import FloatingArm
from ...analysis.full_reduction import Reduction
from ...analysis.phases.gait import Gait
from ...analysis.phases.phase import phase, rigid_body_phase
from ...analysis.stability.along_motions import linearise
from ...common.arrays import Array
from ...common.errors import ModelWarning
from ...forces.kinds import PotentialEnergy
from ...scene.event import Event
from ...simulation.simulate import simulate
from ...system.load import load
from ...system.robot_description import Model
from ...system.system import System
from ..stress.accuracy_and_conservation import euler_top
from .row import Numbers, numbers, row

MOMENTS = np.array([1.0, 2.0, 2.5])  # of the bundled robot rigid_body [kg m²]


@row("L. D. Landau, E. M. Lifshitz, Mechanics, §37", relative=1e-11)
def euler_rates() -> Numbers:
    """Compare Jacobi's elliptic functions with a simulation.

    Returns:
        Euler's rigid body: angular velocity in the body after 20 s [rad/s].
    """
    omega = np.array([0.5, 0.7, 1.6])
    rates, _ = euler_top(MOMENTS, omega, np.array([20.0]))
    traj = simulate(load("rigid_body"), xi0=omega, duration=20.0, rtol=1e-13, atol=1e-15)
    return numbers(rates[0], traj.xi[-1])


@row("R. Montgomery, Am. J. Phys. 59 (1991) 394", relative=1e-11)
def montgomery_phase() -> Numbers:
    """Compare 2ET/J − Λ, with Λ by quadrature, with both routes of pinred.

    Returns:
        Montgomery's phase: rotation about the momentum in one period, by formula and simulated
        [rad].
    """
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
    "L. D. Landau, E. M. Lifshitz, Mechanics, §37; M. S. Ashbaugh, C. C. Chicone, R. H. Cushman, "
    "J. Dyn. Differ. Equ. 3 (1991) 67",
    relative=1e-9,
)
def dzhanibekov_flips() -> Numbers:
    """Compare half a period of the elliptic functions with the zeros of ω₂ in a simulation.

    Returns:
        Dzhanibekov's effect: time between two flips, from (0.01, 1, 0) rad/s [s].
    """
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


GRAVITY = 9.81  # [m/s²]
# Lagrange's top: transverse and axial moments about the pivot [kg m²], and m g l [N m].
I1, I3, PULL = 0.35, 0.05, GRAVITY * 0.5
LAGRANGE = Model("top").body("top", mass=1.0, inertia=[0.1, 0.1, 0.05], com=[0.0, 0.0, 0.5])
# Kovalevskaya's top: moments (2, 2, 1)/2 about the pivot, centre of mass on the first axis.
KOVALEVSKAYA = Model("top").body("top", mass=1.0, inertia=[1.0, 0.84, 0.34], com=[0.4, 0.0, 0.0])


@row("H. Goldstein, Classical Mechanics, §5.7", relative=1e-10)
def lagrange_nutation() -> Numbers:
    """Compare a complete elliptic integral with the turning points of a simulation.

    Returns:
        Lagrange's top, released from 0.6 rad with a spin of 40 rad/s: period of nutation [s].
    """
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


@row("J. E. Marsden, T. S. Ratiu, Introduction to Mechanics and Symmetry, §15.10", relative=1e-10)
def sleeping_top() -> Numbers:
    """Compare √(m g l/I₁ − (I₃ω/2I₁)²) with an eigenvalue of the linearised flow.

    Returns:
        Lagrange's sleeping top at 0.9 of the critical spin: growth of a perturbation [1/s].
    """
    spin = 0.9 * np.sqrt(4.0 * PULL * I1) / I3
    growth = np.sqrt(PULL / I1 - (0.5 * I3 * spin / I1) ** 2)
    traj = simulate(load(LAGRANGE, group="SO3"), xi0=[0.0, 0.0, spin], duration=0.1)
    return numbers(growth, np.max(linearise(traj, 0.0).eigenvalues.real))


@row("S. Kowalevski, Acta Math. 12 (1889) 177", relative=1e-10)
def kovalevskaya_integral() -> Numbers:
    """Compare |(ω₁ + iω₂)² − n (Γ₁ + iΓ₂)|² before and after a simulation.

    Returns:
        Kovalevskaya's top: the fourth integral after 10 s [1/s⁴].
    """
    n = GRAVITY * 0.4 / 0.5
    traj = simulate(
        load(KOVALEVSKAYA, group="SO3"), xi0=[0.7, -0.4, 1.1], duration=10.0,
        rtol=1e-13, atol=1e-15,
    )  # fmt: skip
    x, y, z, w = traj.pose.T
    up = 2.0 * (x * z - y * w) + 2.0j * (y * z + x * w)
    integral = np.abs((traj.xi[:, 0] + 1j * traj.xi[:, 1]) ** 2 - n * up) ** 2
    return numbers(integral[0], integral[-1])


SREENATH = (
    "N. Sreenath, Y.-G. Oh, P. S. Krishnaprasad, J. E. Marsden, Dyn. Stab. Systems 3 (1988) 25"
)
OH = "Y.-G. Oh, N. Sreenath, P. S. Krishnaprasad, J. E. Marsden, J. Dyn. Differ. Equ. 1 (1989) 269"
MASS, MOMENT, ARM = (3.0, 1.2), (0.5, 0.3), (0.4, 0.7)  # two bodies: [kg], [kg m²], [m]
TWO = (
    Model("two_bodies")
    .body("first", mass=MASS[0], inertia=MOMENT[0])
    .hinge("second", parent="first", axis="z", at=[ARM[0], 0.0, 0.0], mass=MASS[1],
           inertia=MOMENT[1], com=[ARM[1], 0.0, 0.0])
)  # fmt: skip


def planar_chain(masses: Array, before: Array, after: Array, moments: Array) -> Model:
    """Return a planar chain; `before` and `after` are distances from the centres to the hinges."""
    model = Model("chain").body("body0", mass=masses[0], inertia=moments[0])
    at = after[0]
    for k in range(1, len(masses)):
        model = model.hinge(
            f"body{k}", parent=f"body{k - 1}", axis="z", at=[at, 0.0, 0.0], mass=masses[k],
            inertia=moments[k], com=[before[k], 0.0, 0.0],
        )  # fmt: skip
        at = before[k] + after[k]
    return model


def couplings(masses: Array, before: Array, after: Array, moments: Array) -> Array:
    """Return the constants K (n, n) of the energy ½ Σ K_ij cos(φ_i − φ_j) φ̇_i φ̇_j."""
    n = len(masses)
    lever = np.diag(before) + np.tril(np.ones((n, n)), -1) * (before + after)
    lever[:, 0] = np.where(np.arange(n) > 0, after[0], 0.0)
    mean = masses @ lever / masses.sum()
    return np.asarray((lever.T * masses) @ lever - masses.sum() * np.outer(mean, mean)
                      + np.diag(moments))  # fmt: skip


# Masses, distances before and behind the centres, and moments, of three bodies.
SHORT = (
    np.array([2.0, 0.5, 1.5]), np.array([0.0, 0.1, 0.6]), np.array([0.5, 0.15, 0.0]),
    np.array([0.2, 0.05, 0.3]),
)  # fmt: skip


@cache
def steady_rotations(name: str, momentum: float) -> Equilibria:
    """Return the steady rotations of a robot of this page at a momentum."""
    robots = {"two bodies": TWO, "short middle": planar_chain(*SHORT), "three_rods": "three_rods"}
    return relative_equilibria(load(robots[name], group="SE2"), momentum=momentum, starts=30)


@row(f"{SREENATH}; docs/errata.md", relative=1e-14)
def coupled_planar() -> Numbers:
    """Compare the fractions of docs/theory.md with the mass matrix.

    Returns:
        two bodies, one pinned at its centre: A and M of robots/coupled_planar.
    """
    red = Reduction(load("coupled_planar"))
    coefficients = [*red.local_connection([0.7])[:, 0], red.reduced_metric([0.7])[0, 0]]
    return numbers([0.0, -1.0 / 30.0, 4.0 / 15.0, 11.0 / 60.0], coefficients)


@row(SREENATH)
def two_bodies_count() -> Numbers:
    """Compare the count of steady rotations: stretched out (stable) and folded (unstable).

    Returns:
        two planar bodies: number of steady rotations, and number of stable ones.
    """
    rotations = steady_rotations("two bodies", 2.0)
    stable = [rotation for rotation in rotations if rotation.verdict == "stable"]
    return numbers([2, 1], [len(rotations), len(stable)])


@row(SREENATH, relative=1e-11)
def two_bodies_oscillation() -> Numbers:
    """Compare μ √(ε d₁ d₂/(M I²)) with the spectrum of both steady rotations.

    Returns:
        two planar bodies at momentum 2: frequency about the stretched, growth about the folded
        [1/s].
    """
    mu, e, cross = 2.0, MASS[0] * MASS[1] / sum(MASS), ARM[0] * ARM[1]
    moments = np.array(MOMENT) + e * np.square(ARM)
    expected = []
    for cosine in (1.0, -1.0):
        total = moments.sum() + 2.0 * e * cross * cosine
        metric = (moments[0] * moments[1] - (e * cross) ** 2) / total
        expected.append(mu * np.sqrt(e * cross / metric) / total)
    rotations = steady_rotations("two bodies", mu)
    return numbers(expected, [rotations[0].frequencies[0], rotations[1].growth])


@row(OH)
def three_bodies_count() -> Numbers:
    """Compare the count by the triangle inequality, 4 or 6, with a search.

    Returns:
        three planar bodies: number of steady rotations of equal rods, and with a short middle
        body.
    """
    names = ("three_rods", "short middle")
    return numbers([4, 6], [len(steady_rotations(name, 1.0)) for name in names])


@row(OH, relative=1e-11)
def three_bodies_triangle() -> Numbers:
    """Compare the angles of the triangle of sides 1/K_ij with a search.

    Returns:
        three planar bodies with a short middle one: joint angles of the bent steady rotation
        [rad].
    """
    K = couplings(*SHORT)
    p, q, s = 1.0 / K[0, 1], 1.0 / K[1, 2], 1.0 / K[0, 2]
    first = np.arccos((q**2 + s**2 - p**2) / (2.0 * q * s))
    second = np.arccos((p**2 + s**2 - q**2) / (2.0 * p * s))
    rotations = steady_rotations("short middle", 1.0)
    angles = [np.mod(rotation.x, 2.0 * np.pi) for rotation in rotations]
    bent = next(x for x in angles if np.abs(np.sin(x)).min() > 1e-3 and x[0] < np.pi)
    return numbers([np.pi - first, np.pi - second], [bent[0], bent[1]])


@row(OH, relative=1e-11)
def three_rods() -> Numbers:
    """Compare the fractions with the spectrum of the steady rotation.

    Returns:
        three equal rods, stretched out and rotating at Ω: frequencies/Ω, √(5/2) and √(81/10).
    """
    lowest = steady_rotations("three_rods", 1.0)[0]
    frequencies = np.sort(lowest.frequencies) / abs(lowest.xi[2])
    return numbers([np.sqrt(2.5), np.sqrt(8.1)], frequencies)


@row(SREENATH, relative=1e-10)
def six_rods() -> Numbers:
    """Compare the eigenvalues of K⁻¹ diag(K 1) − 1 with the linearised flow.

    Returns:
        six equal rods, stretched out and rotating at 1 rad/s: frequencies [rad/s].
    """
    half, one = np.full(6, 0.5), np.ones(6)
    rods = one, half, half, one / 12.0
    K = couplings(one, half * (np.arange(6) > 0), half, one / 12.0)
    squares = np.sort(eigvals(np.diag(K.sum(axis=1)), K).real)[1:] - 1.0
    traj = simulate(load(planar_chain(*rods), group="SE2"), x0=[0.0] * 5, xdot0=[0.0] * 5,
                    xi0=[0.0, 2.5, 1.0], duration=0.1)  # fmt: skip
    spectrum = linearise(traj, 0.0).eigenvalues
    frequencies = np.sort(spectrum.imag[spectrum.imag > 0.1])
    return numbers(np.sqrt(squares), frequencies)


Spectrum: TypeAlias = NDArray[np.complex128]
SCHEURLE = "J. E. Marsden, J. Scheurle, Z. angew. Math. Phys. 44 (1993) 17"
MASSES, LENGTHS = (2.0, 1.0), (1.0, 1.5)  # [kg], [m]
RATIO, TOTAL = LENGTHS[1] / LENGTHS[0], sum(MASSES) / MASSES[1]  # r and m of the source


@cache
def pendulum() -> System:
    """Return two point masses on rods; rings without moment carry the universal joints."""
    model = (
        Model("pendulum").body("azimuth", mass=1.0)
        .hinge("tilt1", parent="azimuth", axis="y", mass=0.5 * MASSES[0], com=[0, 0, -LENGTHS[0]])
        .hinge("swing2", parent="tilt1", axis="x", at=[0, 0, -LENGTHS[0]], mass=0.5 * MASSES[0])
        .hinge("tilt2", parent="swing2", axis="y", mass=MASSES[1], com=[0, 0, -LENGTHS[1]])
    )  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)  # the straight pendulum is singular
        return load(model, group="SO2")


def steady(alpha: complex) -> tuple[complex, complex]:
    """Return λ² and the angular velocity of the steady motion q₂ = α q₁."""
    a, b = (alpha * (TOTAL + alpha)) ** 2, (TOTAL * (1.0 + alpha)) ** 2
    square = (a - RATIO**2 * b) / (a - alpha**2 * b)
    scale = GRAVITY / LENGTHS[0] * TOTAL / (TOTAL + alpha)
    return square, (scale / (1.0 - square) ** 0.5) ** 0.5


def momentum(alpha: complex) -> complex:
    """Return the momentum of the steady motion q₂ = α q₁."""
    square, omega = steady(alpha)
    return omega * LENGTHS[0] ** 2 * square * (MASSES[0] + MASSES[1] * (1.0 + alpha) ** 2)


def spectrum(alpha: float) -> Spectrum:
    """Return the eigenvalues of the Lagrangian in horizontal coordinates, in rotating axes."""
    y, v, rate = ca.SX.sym("y", 4), ca.SX.sym("v", 4), steady(alpha)[1].real
    turned = v + rate * ca.vertcat(-y[1], y[0], -y[3], y[2])  # velocity in fixed axes
    height, climb = [], []
    for k, length in enumerate(LENGTHS):
        q, qdot = y[2 * k : 2 * k + 2], turned[2 * k : 2 * k + 2]
        height.append(-ca.sqrt(length**2 - ca.sumsqr(q)))
        climb.append(-ca.dot(q, qdot) / height[-1])
    energy = 0.5 * MASSES[0] * (ca.sumsqr(turned[:2]) + climb[0] ** 2)
    energy += 0.5 * MASSES[1] * (ca.sumsqr(turned[:2] + turned[2:]) + (climb[0] + climb[1]) ** 2)
    L = energy - GRAVITY * (sum(MASSES) * height[0] + MASSES[1] * height[1])
    p = ca.gradient(L, v)
    parts = [ca.jacobian(p, v), ca.jacobian(p, y), ca.hessian(L, y)[0]]
    s = LENGTHS[0] * np.sqrt(steady(alpha)[0].real)
    place = [s, 0.0, alpha * s, 0.0]
    H, D, K = (np.array(m) for m in ca.Function("L", [y, v], parts)(place, [0.0] * 4))
    lower = np.linalg.solve(H, np.hstack([K, D.T - D]))
    return np.asarray(np.linalg.eigvals(np.vstack([np.eye(4, 8, 4), lower])))


def spectrum_by_pinred(alpha: float) -> Spectrum:
    """Return the eigenvalues of the steady motion, linearised by pinred."""
    square, omega = (number.real for number in steady(alpha))
    first = -np.arcsin(np.sqrt(square))
    second = -np.arcsin(alpha * np.sqrt(square) / RATIO) - first
    x0 = {"tilt1": first, "swing2": 0.0, "tilt2": second}
    traj = simulate(pendulum(), x0=x0, xdot0=[0.0] * 3, xi0=[omega], duration=0.05)
    return linearise(traj, 0.0).eigenvalues


def cubic(eigenvalues: Spectrum) -> Array:
    """Return a, b, c of z³ + a z² + b z + c, whose roots are the squares of the eigenvalues."""
    return np.asarray(np.poly(eigenvalues).real[2:7:2])


def window(eigenvalues: Callable[[float], Spectrum]) -> list[float]:
    """Return the values of α where two frequencies collide, and where one is zero."""

    def discriminant(alpha: float) -> float:
        a, b, c = cubic(eigenvalues(alpha))
        return float(a**2 * b**2 - 4.0 * b**3 - 4.0 * a**3 * c - 27.0 * c**2 + 18.0 * a * b * c)

    edges = (discriminant, -2.5, -2.4), (lambda alpha: cubic(eigenvalues(alpha))[2], -1.9, -1.75)
    return [brentq(f, low, high, xtol=1e-13, rtol=1e-14) for f, low, high in edges]


@row(SCHEURLE, relative=1e-10)
def pendulum_fold() -> Numbers:
    """Compare the zero of dJ/dα, by complex steps, with a zero eigenvalue of the motion.

    Returns:
        double spherical pendulum, m = 3, r = 1.5: fold of the cowboy motions, α and momentum [N m
        s].
    """
    slope = lambda alpha: momentum(alpha + 1e-30j).imag  # noqa: E731
    expected = brentq(slope, -1.9, -1.75, xtol=1e-14)
    fold = brentq(lambda alpha: cubic(spectrum_by_pinred(alpha))[2], -1.9, -1.75, xtol=1e-13)
    return numbers([expected, momentum(expected).real], [fold, momentum(fold).real])


@row(SCHEURLE, relative=1e-8)
def cowboy_window() -> Numbers:
    """Compare the edges by a Lagrangian in horizontal coordinates with the linearised flow.

    Returns:
        double spherical pendulum, m = 3, r = 1.5: edges of the stable cowboy motions, as α.
    """
    return numbers(window(spectrum), window(spectrum_by_pinred))


BEANIE = "J. E. Marsden, R. Montgomery, T. S. Ratiu, Memoirs AMS 436 (1990)"
CAT = "T. R. Kane, M. P. Scher, Int. J. Solids Structures 5 (1969) 663"
CAT_RATIO = 0.4  # axial over transverse moment of half a cat, robots/falling_cat_ball


@row(BEANIE, relative=1e-13)
def beanie_turn() -> Numbers:
    """Compare −2π I₂/(I₁ + I₂), for I₁ = 2 and I₂ = 1, with the phase of one turn.

    Returns:
        Elroy's beanie: rotation of the boy by one turn of the propeller [rad].
    """
    connection = Connection.mechanical(load("elroys_beanie"))
    turn = phase(connection, Gait.waypoints([[0.0]], turns=[1]))
    return numbers(-2.0 * np.pi / 3.0, turn.pose[0])


@row(BEANIE, relative=1e-11)
def beanie_swing() -> Numbers:
    """Compare 4 K(sin² 1)/ω₀, with ω₀² = k (I₁ + I₂)/(I₁ I₂), with a simulation.

    Returns:
        Elroy's beanie with V = −3 cos θ₂, amplitude 2 rad: period [s].
    """
    period = 4.0 * ellipk(np.sin(1.0) ** 2) / np.sqrt(3.0 * 3.0 / 2.0)
    robot = load("elroys_beanie")
    well = PotentialEnergy(lambda x: -3.0 * ca.cos(x[0]))
    middle = Event(lambda _t, x, _xdot, _mu: x[0], "middle", direction=-1)
    traj = simulate(robot, x0=[2.0], xdot0=[0.0], xi0=[0.4], duration=2.0 * period, forces=[well],
                    events=[middle], rtol=1e-13, atol=1e-15)  # fmt: skip
    times = traj.events["middle"].t
    return numbers(period, times[1] - times[0])


def rolling(bend: Array, heading: Array) -> Gait:
    """Return the gait of a cat whose bend rolls without twist, from samples over one cycle."""
    samples = bend[:, None] * np.stack([0.0 * heading, np.cos(heading), np.sin(heading)], axis=1)
    modes = np.fft.rfft(samples, axis=0)[: len(samples) // 4] / len(samples)
    return Gait.fourier(modes[0].real, 2.0 * modes[1:].real, -2.0 * modes[1:].imag)


def roll_rate(bend: float) -> float:
    """Return the turn of the bisector per radian of heading: k c/(k c² + s²)."""
    c, s = np.cos(0.5 * bend), np.sin(0.5 * bend)
    return float(CAT_RATIO * c / (CAT_RATIO * c**2 + s**2))


@row("R. Montgomery, Fields Inst. Commun. 1 (1993) 193", relative=1e-12)
def cat_equal_bends() -> Numbers:
    """Compare π, for cos(b) = (√(k² − k + 1) − k)/(1 − k), with the phase of the circle.

    Returns:
        falling cat, bent by 76.3° to all sides in turn: rotation, half a turn [rad].
    """
    half = np.arccos((np.sqrt(CAT_RATIO**2 - CAT_RATIO + 1.0) - CAT_RATIO) / (1.0 - CAT_RATIO))
    heading = 2.0 * np.pi * np.arange(16) / 16
    gait = rolling(np.full(16, 2.0 * half), heading)
    connection = Connection.mechanical(load("falling_cat_ball"))
    return numbers(np.pi, phase(connection, gait).screw.angle)


@row(CAT, relative=1e-10)
def kane_scher_cat() -> Numbers:
    """Compare ∫ (1 − k c/(k c² + s²)) dφ over a cone with the phase of pinred.

    Returns:
        Kane and Scher's cat, bent by 100° forward and 20° backward: rotation [rad].
    """
    tilt, cone = np.radians(40.0), np.radians(60.0)

    def spine(theta: Array) -> tuple[Array, Array]:
        """Return bend and heading of the rear axis on its cone."""
        across = np.sin(cone) * np.sin(theta)
        ahead = np.sin(tilt) * np.cos(cone) + np.cos(tilt) * np.sin(cone) * np.cos(theta)
        along = np.cos(tilt) * np.cos(cone) - np.sin(tilt) * np.sin(cone) * np.cos(theta)
        return np.arctan2(np.hypot(ahead, across), along), np.arctan2(across, ahead)

    def slope(theta: float) -> float:
        step = 1e-3 * np.array([-3, -2, -1, 1, 2, 3])
        heading = np.unwrap(spine(theta + step)[1])
        return float(np.dot([-1, 9, -45, 45, -9, 1], heading)) / 0.06

    expected = quad(
        lambda t: (1.0 - roll_rate(float(spine(np.array(t))[0]))) * slope(t), 0.0, 2.0 * np.pi,
        epsabs=1e-12, epsrel=1e-12, limit=200,
    )[0]  # fmt: skip
    theta = 2.0 * np.pi * np.arange(400) / 400
    connection = Connection.mechanical(load("falling_cat_ball"))
    angle = phase(connection, rolling(*spine(theta))).screw.angle
    return numbers(expected, angle)


@row("Z. Li, R. Montgomery, Proc. IEEE Int. Conf. Robotics and Automation (1990)", relative=1e-12)
def hopper() -> Numbers:
    """Compare −Δψ (A(l₁) − A(l₂)) with the phase of four strokes.

    Returns:
        hopper in flight: rotation of the body by a rectangle of hip angle and leg length [rad].
    """
    robot = (
        Model("hopper").body("trunk", mass=10.0, inertia=1.0)
        .hinge("hip", parent="trunk", axis="z", mass=0.5, inertia=0.02)
        .slide("leg", parent="hip", axis="x", at=[0.5, 0.0, 0.0], mass=1.0, inertia=0.01)
    )  # fmt: skip

    def share(length: float) -> float:
        leg = 0.03 + 1.0 * 10.5 / 11.5 * length**2
        return leg / (1.0 + leg)

    connection = Connection.mechanical(load(robot, group="SE2"))
    moves = [{"hip": 1.5}, {"leg": 0.4}, {"hip": -1.5}, {"leg": -0.4}]
    gait = Gait.strokes([0.0, 0.0], moves, connection.joints)
    return numbers(1.5 * (share(0.9) - share(0.5)), phase(connection, gait).pose[2])


@row("H. R. Dullin, W. Tong, SIAM J. Appl. Dyn. Syst. 15 (2016) 1806", relative=1e-10)
def diver_arm() -> Numbers:
    """Compare an arctangent with a simulation of robots/diver at zero momentum.

    Returns:
        diver who swings one arm down through half a turn: tilt of the body [rad].
    """
    shoulder, arm = np.array([0.2, 0.45]), np.array([0.0, -0.3])  # across and up [m]
    bodies = ((42.0, [0.0, 0.2], 2.2), (25.0, [0.0, -0.5], 1.6), (4.0, [-0.2, 0.75], 0.12))
    mass = sum(body[0] for body in bodies)
    centre = np.asarray(sum(m * np.array(c) for m, c, _ in bodies)) / mass
    without_arm = sum(moment + m * np.sum((np.array(c) - centre) ** 2) for m, c, moment in bodies)
    offset, e = shoulder - centre, 4.0 * mass / (4.0 + mass)
    P = without_arm + 0.12 + e * (offset @ offset + arm @ arm)
    Q = 2.0 * e * np.hypot(*offset) * np.hypot(*arm)
    least = np.arctan2(offset[1], offset[0]) - np.arctan2(arm[1], arm[0])
    angles = np.array([0.0, np.pi]) - least
    turns = np.floor((angles + np.pi) / (2.0 * np.pi))
    root = np.sqrt(P**2 - Q**2)
    primitive = 2.0 / root * (np.arctan(root / (P + Q) * np.tan(0.5 * angles)) + np.pi * turns)
    more = 0.12 - without_arm + e * (arm @ arm - offset @ offset)
    tilt = 0.5 * (np.pi + more * (primitive[1] - primitive[0]))
    robot = load("diver", lock={"hips": [0, 0, 0], "right_shoulder": [np.pi, 0, 0]})
    swing = {"left_shoulder": [f"{np.pi!r}*(1 + cos({np.pi!r}*t))/2", "0*t", "0*t"]}
    traj = simulate(robot, prescribed=swing, momentum=0, duration=1.0, rtol=1e-13, atol=1e-15)
    return numbers([tilt, 0.0, 0.0], Rotation.from_quat(traj.pose[-1, 3:]).as_rotvec())


VIRTUAL = (
    "Z. Vafa, S. Dubowsky, Int. J. Robotics Res. 9 (1990) 3; Y. Umetani, K. Yoshida, "
    "IEEE Trans. Robotics and Automation 5 (1989) 303"
)


@row("E. Papadopoulos, S. Dubowsky, J. Dyn. Sys., Meas., Control 115 (1993) 44", printed="-11.41")
def dynamic_singularity() -> Numbers:
    """Compare the printed angle with the root of the least singular value.

    Returns:
        planar arm of 40, 4 and 3 kg: second joint at a dynamic singularity, first at −65° [°].
    """
    arm = FloatingArm(load("floating_arm"), "hand")
    (angle,) = arm.singular_values_of("q2", [np.radians(-65.0), 0.0], limits=(-1.5, 1.5))
    return numbers(-11.41, np.degrees(angle))


def virtual_jacobian(x: Array) -> Array:
    """Return the generalised Jacobian (2, 2) of the same arm by virtual links."""
    masses, moments = np.array([40.0, 4.0, 3.0]), np.diag([6.667, 0.333, 0.25])
    lever = np.array([[0.0, 0.0, 0.0], [0.5, 0.5, 0.0], [0.5, 1.0, 0.5]])  # of the three centres
    mean = masses @ lever / masses.sum()
    K = (lever.T * masses) @ lever - masses.sum() * np.outer(mean, mean) + moments
    virtual = np.array([0.5, 1.0, 1.0]) - mean
    angle = np.array([0.0, x[0], x[0] + x[1]])
    inertia = (K * np.cos(angle[:, None] - angle)).sum(axis=1)
    joints = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])  # derivatives of the link angles
    rates = joints - np.outer(np.ones(3), inertia @ joints / inertia.sum())
    return np.asarray(np.array([-virtual * np.sin(angle), virtual * np.cos(angle)]) @ rates)


@row(VIRTUAL, relative=1e-9)
def singular_angle() -> Numbers:
    """Compare the zero of the determinant of virtual links with the singular value.

    Returns:
        the same angle, to all digits, by virtual links [°].
    """
    first = np.radians(-65.0)
    expected = brentq(lambda q2: np.linalg.det(virtual_jacobian(np.array([first, q2]))), -0.5, 0.0,
                      xtol=1e-14)  # fmt: skip
    arm = FloatingArm(load("floating_arm"), "hand")
    (angle,) = arm.singular_values_of("q2", [first, 0.0], limits=(-1.5, 1.5))
    return numbers(np.degrees(expected), np.degrees(angle))


@row(VIRTUAL, relative=1e-13)
def virtual_manipulator() -> Numbers:
    """Compare virtual links about the centre of mass with the generalised Jacobian.

    Returns:
        the same arm: its generalised Jacobian at (0.4, 0.9) rad, by virtual links [m].
    """
    x = np.array([0.4, 0.9])
    arm = FloatingArm(load("floating_arm"), "hand")
    jacobian = arm.generalized_jacobian(x, axes="world")[:2]
    return numbers(virtual_jacobian(x).ravel(), jacobian.ravel())


@row("SpaceDyn, Space Robotics Laboratory, Tohoku University, Set_global_value.py", relative=1e-13)
def spacedyn_one_link() -> Numbers:
    """Compare −5/36 and −13/36 with the connection.

    Returns:
        SpaceDyn's example of one link: rates of the base about y and z per joint rate.
    """
    robot = (
        Model("one_link").body("base", mass=100.0, inertia=10.0)
        .hinge("link", parent="base", axis="z", at=[0.0, 0.5, 0.0], mass=100.0, inertia=10.0,
               com=[0.0, 0.0, 0.5])
    )  # fmt: skip
    A = Reduction(load(robot)).local_connection([0.8])
    return numbers([-5.0 / 36.0, -13.0 / 36.0], -A[4:, 0])


@row("K. Yoshida, Int. J. Robotics Res. 22 (2003) 321; numbers of our own", relative=1e-11)
def satellite_arm() -> Numbers:
    """Compare arctangents with the phase: a turn by 90°, out, back, and in.

    Returns:
        satellite of 2500 kg, arm of 150 kg as ETS-VII: turn of the base by a loop of the arm
        [rad].
    """
    mass, arm, at, reach = 2500.0, 150.0, 1.2, 1.0
    robot = (
        Model("satellite").body("base", mass=mass, inertia=2000.0)
        .hinge("shoulder", parent="base", axis="z", at=[at, 0.0, 0.0], mass=0.5 * arm, inertia=30.0)
        .slide("boom", parent="shoulder", axis="x", mass=0.5 * arm, inertia=20.0)
    )  # fmt: skip

    half = 0.5 * arm  # at the shoulder, so it moves with the base
    carrier = mass + half
    e, lever = half * carrier / (half + carrier), at * mass / carrier
    base_inertia = 2000.0 + mass * half / carrier * at**2 + e * lever**2

    def by_shoulder(length: float) -> float:
        """Return the integral of A while the shoulder turns from 0 to 90°."""
        link, Q = 50.0 + e * length**2, 2.0 * e * lever * length
        P = base_inertia + link
        root = np.sqrt(P**2 - Q**2)
        return float(0.25 * np.pi + (link - base_inertia) / root * np.arctan(root / (P + Q)))

    def by_boom(length: float) -> float:
        """Return the integral of A while the boom at 90° grows from zero to a length."""
        scale = np.sqrt(e / (base_inertia + 50.0))
        return float(lever * scale * np.arctan(scale * length))

    changes = (by_shoulder(reach), by_boom(reach + 1.0) - by_boom(reach), -by_shoulder(reach + 1.0))
    connection = Connection.mechanical(load(robot, group="SE2"))
    moves = [{"shoulder": np.pi / 2}, {"boom": 1.0}, {"shoulder": -np.pi / 2}, {"boom": -1.0}]
    gait = Gait.strokes([0.0, reach], moves, connection.joints)
    return numbers(-sum(changes), phase(connection, gait).pose[2])
