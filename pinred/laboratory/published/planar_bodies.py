"""Coupled rigid bodies in the plane: numbers, shapes and stability of their steady rotations."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.linalg import eigvals

from ...analysis.equilibria.relative_equilibrium import Equilibria
from ...common.arrays import Array
from .public_names import Model, Reduction, linearise, load, relative_equilibria, simulate
from .row import Numbers, numbers, row

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


def chain(masses: Array, before: Array, after: Array, moments: Array) -> Model:
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
    robots = {"two bodies": TWO, "short middle": chain(*SHORT), "three_rods": "three_rods"}
    return relative_equilibria(load(robots[name], group="SE2"), momentum=momentum, starts=30)


@row(
    "coupled-planar",
    "two bodies, one pinned at its centre: A and M of robots/coupled_planar",
    f"{SREENATH}; docs/errata.md",
    relative=1e-14,
)
def coupled_planar() -> Numbers:
    """Compare the fractions of docs/theory.md with the mass matrix."""
    red = Reduction(load("coupled_planar"))
    found = [*red.local_connection([0.7])[:, 0], red.reduced_metric([0.7])[0, 0]]
    return numbers([0.0, -1.0 / 30.0, 4.0 / 15.0, 11.0 / 60.0], found)


@row(
    "two-bodies-count",
    "two planar bodies: number of steady rotations, and number of stable ones",
    SREENATH,
)
def two_bodies_count() -> Numbers:
    """Compare the count of steady rotations: stretched out (stable) and folded (unstable)."""
    found = steady_rotations("two bodies", 2.0)
    return numbers([2, 1], [len(found), sum(each.verdict == "stable" for each in found)])


@row(
    "two-bodies-oscillation",
    "two planar bodies at momentum 2: frequency about the stretched, growth about the folded [1/s]",
    SREENATH,
    relative=1e-11,
)
def two_bodies_oscillation() -> Numbers:
    """Compare μ √(ε d₁ d₂/(M I²)) with the spectrum of both steady rotations."""
    mu, e, cross = 2.0, MASS[0] * MASS[1] / sum(MASS), ARM[0] * ARM[1]
    own = np.array(MOMENT) + e * np.square(ARM)
    expected = []
    for cosine in (1.0, -1.0):
        total = own.sum() + 2.0 * e * cross * cosine
        metric = (own[0] * own[1] - (e * cross) ** 2) / total
        expected.append(mu * np.sqrt(e * cross / metric) / total)
    found = steady_rotations("two bodies", mu)
    return numbers(expected, [found[0].frequencies[0], found[1].growth])


@row(
    "three-bodies-count",
    "three planar bodies: number of steady rotations of equal rods, and with a short middle body",
    OH,
)
def three_bodies_count() -> Numbers:
    """Compare the count by the triangle inequality, 4 or 6, with a search."""
    names = ("three_rods", "short middle")
    return numbers([4, 6], [len(steady_rotations(name, 1.0)) for name in names])


@row(
    "three-bodies-triangle",
    "three planar bodies with a short middle one: joint angles of the bent steady rotation [rad]",
    OH,
    relative=1e-11,
)
def three_bodies_triangle() -> Numbers:
    """Compare the angles of the triangle of sides 1/K_ij with a search."""
    K = couplings(*SHORT)
    p, q, s = 1.0 / K[0, 1], 1.0 / K[1, 2], 1.0 / K[0, 2]
    first = np.arccos((q**2 + s**2 - p**2) / (2.0 * q * s))
    second = np.arccos((p**2 + s**2 - q**2) / (2.0 * p * s))
    found = steady_rotations("short middle", 1.0)
    angles = [np.mod(each.x, 2.0 * np.pi) for each in found]
    bent = next(x for x in angles if np.abs(np.sin(x)).min() > 1e-3 and x[0] < np.pi)
    return numbers([np.pi - first, np.pi - second], [bent[0], bent[1]])


@row(
    "three-rods",
    "three equal rods, stretched out and rotating at Ω: frequencies/Ω, √(5/2) and √(81/10)",
    OH,
    relative=1e-11,
)
def three_rods() -> Numbers:
    """Compare the fractions with the spectrum of the steady rotation."""
    lowest = steady_rotations("three_rods", 1.0)[0]
    found = np.sort(lowest.frequencies) / abs(lowest.xi[2])
    return numbers([np.sqrt(2.5), np.sqrt(8.1)], found)


@row(
    "six-rods",
    "six equal rods, stretched out and rotating at 1 rad/s: frequencies [rad/s]",
    SREENATH,
    relative=1e-10,
)
def six_rods() -> Numbers:
    """Compare the eigenvalues of K⁻¹ diag(K 1) − 1 with the linearised flow."""
    half, one = np.full(6, 0.5), np.ones(6)
    rods = one, half, half, one / 12.0
    K = couplings(one, half * (np.arange(6) > 0), half, one / 12.0)
    squares = np.sort(eigvals(np.diag(K.sum(axis=1)), K).real)[1:] - 1.0
    traj = simulate(load(chain(*rods), group="SE2"), x0=[0.0] * 5, xdot0=[0.0] * 5,
                    xi0=[0.0, 2.5, 1.0], duration=0.1)  # fmt: skip
    spectrum = linearise(traj, 0.0).eigenvalues
    found = np.sort(spectrum.imag[spectrum.imag > 0.1])
    return numbers(np.sqrt(squares), found)


ROWS = (
    coupled_planar, two_bodies_count, two_bodies_oscillation, three_bodies_count,
    three_bodies_triangle, three_rods, six_rods,
)  # fmt: skip
