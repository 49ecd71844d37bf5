"""Lifts of gaits by SciPy and Pinocchio's mass matrix: an independent reference for phases."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
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


def by_pinocchio(system: pinred.System, gait: pinred.Gait, momentum: Array) -> Array:
    """Return the pose after one cycle for an initial body momentum (r,)."""
    red, group = pinred.Reduction(system), system.group

    def velocity(g: Array, x: Array, xdot: Array) -> Array:
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
