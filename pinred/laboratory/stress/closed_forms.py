"""Motions that are known in closed form: the other side of what is measured."""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh
from scipy.special import ellipj, ellipk, ellipkinc

from ...common.arrays import Array


def euler_top(moments: Array, omega: Array, times: Array) -> tuple[Array, float]:
    """Return the body rates (T, 3) of a free rigid body and their period [s].

    moments: (3,) increasing, all different.  omega: (3,) at time 0, not on a separatrix.
    L. D. Landau, E. M. Lifshitz, Mechanics, 3rd ed., §37.
    """
    a, b, c = moments
    energy2, square = float(moments @ omega**2), float(moments**2 @ omega**2)
    order = [0, 1, 2]
    if square < energy2 * b:  # about the axis of the least moment: the roles change
        order, (a, c) = [2, 1, 0], (c, a)
    w1, w2, w3 = omega[order]
    most = np.sqrt(
        [
            (energy2 * c - square) / (a * (c - a)),
            (energy2 * c - square) / (b * (c - b)),
            (square - energy2 * a) / (c * (c - a)),
        ]
    )
    m = (b - a) * (energy2 * c - square) / ((c - b) * (square - energy2 * a))
    speed = np.sqrt((c - b) * (square - energy2 * a) / (a * b * c))
    # The order (3, 2, 1) is left-handed, but its moments decrease: the sense is the same.
    sense = np.sign(w3)
    phase = ellipkinc(np.arctan2(w2 / most[1], w1 / most[0]), m)
    period = 4.0 * ellipk(m)
    sn, cn, dn, _ = ellipj(np.mod(phase + sense * speed * times, period), m)
    rates = np.empty((len(times), 3))
    rates[:, order] = np.stack([most[0] * cn, most[1] * sn, np.sign(w3) * most[2] * dn], axis=1)
    return rates, float(period / speed)


def symmetric_top(moment: float, axial: float, omega: Array, times: Array) -> Array:
    """Return the attitudes (T, 3, 3) of a free body with moments (moment, moment, axial).

    It starts at the identity with body rates omega (3,): R(t) = exp(t J/I) exp(t ω₃(1 − C/I) e₃).
    """
    J = np.array([moment, moment, axial]) * omega
    spin = np.array([0.0, 0.0, (1.0 - axial / moment) * omega[2]])
    return np.array([_turn(t * J / moment) @ _turn(t * spin) for t in times])


def _turn(vector: Array) -> Array:
    """Return the rotation by a vector (3,), by Rodrigues' formula."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K)


def discs(
    moments: Array, stiffness: Array, x0: Array, rates: Array, times: Array
) -> tuple[Array, Array]:
    """Return the first angle (T,) and the twists (T, m) of m + 1 discs on one axis.

    moments: (m + 1,).  stiffness: (m,) of the springs between neighbours, at rest untwisted.
    x0: (m,) twists, rates: (m + 1,) of the first disc and of the twists, at time 0, where the
    first angle is 0.  The normal modes of a linear system.
    """
    m = len(stiffness)
    absolute = np.tril(np.ones((m + 1, m + 1)))  # angles of the discs from the first and twists
    H = absolute.T @ np.diag(moments) @ absolute
    metric = H[1:, 1:] - np.outer(H[0, 1:], H[0, 1:]) / H[0, 0]
    square, modes = eigh(np.diag(stiffness), metric)
    omega = np.sqrt(square)
    start, begin = modes.T @ metric @ x0, modes.T @ metric @ rates[1:]
    angle = np.outer(times, omega)
    twists = (start * np.cos(angle) + begin / omega * np.sin(angle)) @ modes.T
    steady = float(H[0] @ rates) / H[0, 0]
    first = steady * times - (twists - x0) @ H[0, 1:] / H[0, 0]
    return np.asarray(first), np.asarray(twists)


def cartpole_period(mass: float, lever: float, moment: float, gravity: float, most: float) -> float:
    """Return the period of a pole that swings to ±most [rad] from a free cart, both at rest there.

    mass: of both [kg].  lever: mass of the pole times the distance of its centre [kg m].
    moment: of the pole about the hinge.  With x = most sin s the integrand is smooth.
    """

    def integrand(s: Array) -> Array:
        x = most * np.sin(s)
        metric = moment - (lever * np.cos(x)) ** 2 / mass
        # cos x − cos most, without its cancellation at the ends
        fall = 2.0 * np.sin(0.5 * (most + x)) * np.sin(0.5 * (most - x))
        return np.asarray(most * np.cos(s) * np.sqrt(metric / (2.0 * lever * gravity * fall)))

    # Of a smooth periodic function, the mean over midpoints converges exponentially.
    count = 400
    middle = -0.5 * np.pi + np.pi * (np.arange(count) + 0.5) / count
    return 2.0 * np.pi * float(np.mean(integrand(middle)))
