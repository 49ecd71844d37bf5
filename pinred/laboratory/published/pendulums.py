"""The double spherical pendulum of Marsden and Scheurle, with point masses."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import cache
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from ...common.arrays import Array
from ...common.errors import ModelWarning
from ...system.system import System
from .public_names import Model, linearise, load, simulate
from .row import Numbers, numbers, row

Spectrum: TypeAlias = NDArray[np.complex128]
SOURCE = "J. E. Marsden, J. Scheurle, Z. angew. Math. Phys. 44 (1993) 17"
GRAVITY, MASS, LENGTH = 9.81, (2.0, 1.0), (1.0, 1.5)  # [m/s²], [kg], [m]
RATIO, TOTAL = LENGTH[1] / LENGTH[0], sum(MASS) / MASS[1]  # r and m of the source


@cache
def pendulum() -> System:
    """Return two point masses on rods; rings without moment carry the universal joints."""
    model = (
        Model("pendulum").body("azimuth", mass=1.0)
        .hinge("tilt1", parent="azimuth", axis="y", mass=0.5 * MASS[0], com=[0.0, 0.0, -LENGTH[0]])
        .hinge("swing2", parent="tilt1", axis="x", at=[0.0, 0.0, -LENGTH[0]], mass=0.5 * MASS[0])
        .hinge("tilt2", parent="swing2", axis="y", mass=MASS[1], com=[0.0, 0.0, -LENGTH[1]])
    )  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)  # the straight pendulum is singular
        return load(model, group="SO2")


def steady(alpha: complex) -> tuple[complex, complex]:
    """Return λ² and the angular velocity of the steady motion q₂ = α q₁."""
    a, b = (alpha * (TOTAL + alpha)) ** 2, (TOTAL * (1.0 + alpha)) ** 2
    square = (a - RATIO**2 * b) / (a - alpha**2 * b)
    scale = GRAVITY / LENGTH[0] * TOTAL / (TOTAL + alpha)
    return square, (scale / (1.0 - square) ** 0.5) ** 0.5


def momentum(alpha: complex) -> complex:
    """Return the momentum of the steady motion q₂ = α q₁."""
    square, omega = steady(alpha)
    return omega * LENGTH[0] ** 2 * square * (MASS[0] + MASS[1] * (1.0 + alpha) ** 2)


def spectrum(alpha: float) -> Spectrum:
    """Return the eigenvalues of the Lagrangian in horizontal coordinates, in rotating axes."""
    y, v, rate = ca.SX.sym("y", 4), ca.SX.sym("v", 4), steady(alpha)[1].real
    turned = v + rate * ca.vertcat(-y[1], y[0], -y[3], y[2])  # velocity in fixed axes
    height, climb = [], []
    for k, length in enumerate(LENGTH):
        q, qdot = y[2 * k : 2 * k + 2], turned[2 * k : 2 * k + 2]
        height.append(-ca.sqrt(length**2 - ca.sumsqr(q)))
        climb.append(-ca.dot(q, qdot) / height[-1])
    energy = 0.5 * MASS[0] * (ca.sumsqr(turned[:2]) + climb[0] ** 2)
    energy += 0.5 * MASS[1] * (ca.sumsqr(turned[:2] + turned[2:]) + (climb[0] + climb[1]) ** 2)
    L = energy - GRAVITY * (sum(MASS) * height[0] + MASS[1] * height[1])
    p = ca.gradient(L, v)
    parts = [ca.jacobian(p, v), ca.jacobian(p, y), ca.hessian(L, y)[0]]
    s = LENGTH[0] * np.sqrt(steady(alpha)[0].real)
    place = [s, 0.0, alpha * s, 0.0]
    H, D, K = (np.array(m) for m in ca.Function("L", [y, v], parts)(place, [0.0] * 4))
    lower = np.linalg.solve(H, np.hstack([K, D.T - D]))
    return np.asarray(np.linalg.eigvals(np.vstack([np.eye(4, 8, 4), lower])))


def spectrum_by_pinred(alpha: float) -> Spectrum:
    """Return the eigenvalues of the steady motion, linearised by pinred."""
    square, omega = (each.real for each in steady(alpha))
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


@row(
    "pendulum-fold",
    "double spherical pendulum, m = 3, r = 1.5: fold of the cowboy motions, α and momentum [N m s]",
    SOURCE,
    relative=1e-10,
)
def pendulum_fold() -> Numbers:
    """Compare the zero of dJ/dα, by complex steps, with a zero eigenvalue of the motion."""
    slope = lambda alpha: momentum(alpha + 1e-30j).imag  # noqa: E731
    expected = brentq(slope, -1.9, -1.75, xtol=1e-14)
    found = brentq(lambda alpha: cubic(spectrum_by_pinred(alpha))[2], -1.9, -1.75, xtol=1e-13)
    return numbers([expected, momentum(expected).real], [found, momentum(found).real])


@row(
    "cowboy-window",
    "double spherical pendulum, m = 3, r = 1.5: edges of the stable cowboy motions, as α",
    SOURCE,
    relative=1e-8,
)
def cowboy_window() -> Numbers:
    """Compare the edges by a Lagrangian in horizontal coordinates with the linearised flow."""
    return numbers(window(spectrum), window(spectrum_by_pinred))


ROWS = (pendulum_fold, cowboy_window)
