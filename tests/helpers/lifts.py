"""Lifts of gaits by SciPy and Pinocchio's mass matrix: an independent reference for phases."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp

import pinred
from pinred.common.arrays import Array
from pinred.lie import Group


def pose_after_cycle(
    group: Group, gait: pinred.Gait, velocity: Callable[[Array, Array, Array], Array]
) -> Array:
    """Return the pose after one cycle, (size,).

    Args:
        group: Symmetry group.
        gait: Closed path of shapes.
        velocity: Body twist ξ as a function of g, x and ẋ.
    """

    def rate(t: float, y: Array) -> Array:
        g = group.normalize(y)
        x, xdot = gait.at(t)
        return group.rate(g, velocity(g, x, xdot))

    g = group.identity()
    for start, end in zip(gait.breaks[:-1], gait.breaks[1:], strict=True):
        # A step must not evaluate the gait beyond a corner.
        before_end = np.nextafter(end, start)
        solution = solve_ivp(rate, (start, before_end), g, method="DOP853", rtol=1e-12, atol=1e-13)
        g = group.normalize(solution.y[:, -1])
    return g


def at_rotation_vectors(
    system: pinred.System, centre: Array, w: Array, wdot: Array
) -> tuple[Array, Array]:
    """Return the shape centre · exp(w), (nx,), and its rates, (m,), by Pinocchio's exponential."""
    x, rates = np.array(centre), wdot.copy()
    x[system.space.scalar_x] += w[system.space.scalar_v]
    for ball in system.space.balls:
        R = pin.Quaternion(centre[ball.x]).matrix() @ pin.exp3(w[ball.v])
        x[ball.x] = pin.Quaternion(R).coeffs()
        rates[ball.v] = pin.Jexp3(w[ball.v]) @ wdot[ball.v]
    return x, rates


def by_pinocchio(
    system: pinred.System, gait: pinred.Gait, momentum: Array, centre: Array | None = None
) -> Array:
    """Return the pose after one cycle for an initial body momentum (r,).

    With a centre, (nx,), the gait is given in rotation vectors of balls about it.
    """
    red, group = pinred.Reduction(system), system.group

    def velocity(g: Array, x: Array, xdot: Array) -> Array:
        if centre is not None:
            x, xdot = at_rotation_vectors(system, centre, x, xdot)
        split = red.split(x)
        mu = group.Ad(g).T @ momentum
        return -split.local_connection @ xdot + np.linalg.solve(split.locked_inertia, mu)

    return pose_after_cycle(group, gait, velocity)


def random_gait(rng: np.random.Generator, m: int, harmonics: int = 2) -> pinred.Gait:
    """Return a random Fourier gait."""
    size = (harmonics, m)
    return pinred.Gait.fourier(
        rng.uniform(-0.5, 0.5, m), rng.uniform(-0.5, 0.5, size), rng.uniform(-0.5, 0.5, size),
        period=float(rng.uniform(0.5, 2.0)),
    )  # fmt: skip
