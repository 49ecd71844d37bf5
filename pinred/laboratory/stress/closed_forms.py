"""Closed-form solutions with which simulated motions are compared."""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh
from scipy.special import ellipj, ellipk, ellipkinc

from ...common.arrays import Array


def euler_top(moments: Array, omega: Array, times: Array) -> tuple[Array, float]:
    """Compute the body rates of a free rigid body (L. D. Landau, E. M. Lifshitz, Mechanics, §37).

    Args:
        moments: Increasing, distinct principal moments of inertia, (3,) [kg·m²].
        omega: Body rates at time 0, (3,) [rad/s], not on a separatrix.
        times: Times, (T,) [s].
    Returns:
        Body rates (T, 3) [rad/s], and their period [s].
    """
    a, b, c = moments
    energy2, square = float(moments @ omega**2), float(moments**2 @ omega**2)
    order = [0, 1, 2]
    if square < energy2 * b:  # the body rotates about the axis of least moment, so exchange axes
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
    # The order (3, 2, 1) is left-handed, but its moments decrease, so the sign is the same.
    sense = np.sign(w3)
    phase = ellipkinc(np.arctan2(w2 / most[1], w1 / most[0]), m)
    period = 4.0 * ellipk(m)
    sn, cn, dn, _ = ellipj(np.mod(phase + sense * speed * times, period), m)
    rates = np.empty((len(times), 3))
    rates[:, order] = np.stack([most[0] * cn, most[1] * sn, np.sign(w3) * most[2] * dn], axis=1)
    return rates, float(period / speed)


def symmetric_top(moment: float, axial: float, omega: Array, times: Array) -> Array:
    """Compute the attitude of a free body with moments (moment, moment, axial).

    The attitude is R(t) = exp(t J/I) exp(t ω₃(1 − C/I) e₃), with the identity at time 0.

    Args:
        moment: Transverse moment of inertia I [kg·m²].
        axial: Axial moment of inertia C [kg·m²].
        omega: Body rates at time 0, (3,) [rad/s].
        times: Times, (T,) [s].
    Returns:
        (T, 3, 3) rotation matrices.
    """
    J = np.array([moment, moment, axial]) * omega
    spin = np.array([0.0, 0.0, (1.0 - axial / moment) * omega[2]])
    return np.array([_rotation(t * J / moment) @ _rotation(t * spin) for t in times])


def _rotation(vector: Array) -> Array:
    """Return the rotation matrix of a rotation vector (3,) by Rodrigues' formula."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K)


def discs(
    moments: Array, stiffness: Array, x0: Array, rates: Array, times: Array
) -> tuple[Array, Array]:
    """Compute the motion of m + 1 discs on one axis by normal modes.

    Args:
        moments: Moments of inertia, (m + 1,) [kg·m²].
        stiffness: Stiffness of the springs between neighbours, (m,) [N·m/rad].
        x0: Twists of the springs at time 0, (m,) [rad].
        rates: Rates of the first disc and of the twists at time 0, (m + 1,) [rad/s].
        times: Times, (T,) [s].
    Returns:
        Angle of the first disc (T,), which is 0 at time 0, and twists (T, m) [rad].
    """
    m = len(stiffness)
    absolute = np.tril(np.ones((m + 1, m + 1)))  # maps the first angle and the twists to all angles
    H = absolute.T @ np.diag(moments) @ absolute
    metric = H[1:, 1:] - np.outer(H[0, 1:], H[0, 1:]) / H[0, 0]
    square, modes = eigh(np.diag(stiffness), metric)
    omega = np.sqrt(square)
    modal_x0, modal_rates = modes.T @ metric @ x0, modes.T @ metric @ rates[1:]
    angle = np.outer(times, omega)
    twists = (modal_x0 * np.cos(angle) + modal_rates / omega * np.sin(angle)) @ modes.T
    steady = float(H[0] @ rates) / H[0, 0]
    first = steady * times - (twists - x0) @ H[0, 1:] / H[0, 0]
    return np.asarray(first), np.asarray(twists)


def cartpole_period(mass: float, lever: float, moment: float, gravity: float, most: float) -> float:
    """Compute the period of a pole that swings on a free cart.

    The substitution x = most · sin s makes the integrand smooth.

    Args:
        mass: Total mass of cart and pole [kg].
        lever: Mass of the pole times the distance of its centre from the hinge [kg·m].
        moment: Moment of inertia of the pole about the hinge [kg·m²].
        gravity: Gravitational acceleration [m/s²].
        most: Amplitude [rad], at which cart and pole are at rest.
    Returns:
        The period [s].
    """

    def integrand(s: Array) -> Array:
        x = most * np.sin(s)
        metric = moment - (lever * np.cos(x)) ** 2 / mass
        # cos x − cos most, without cancellation near the amplitude
        height = 2.0 * np.sin(0.5 * (most + x)) * np.sin(0.5 * (most - x))
        return np.asarray(most * np.cos(s) * np.sqrt(metric / (2.0 * lever * gravity * height)))

    # The midpoint rule converges exponentially for smooth periodic functions.
    count = 400
    middle = -0.5 * np.pi + np.pi * (np.arange(count) + 0.5) / count
    return 2.0 * np.pi * float(np.mean(integrand(middle)))
