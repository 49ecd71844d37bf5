"""Closed loops in the validation of kernels, with Jacobians by Pinocchio."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from ..common.arrays import Array
from ..reduction.tree.loop_constraints import GAUGE_RATE
from ..system.loops.looped_system import loop_jacobian, loop_jacobian_rate

if TYPE_CHECKING:
    from ..system.system import System


def with_closed_loops(
    system: System, x: Array, H: Array, v: Array, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Project v on velocities that keep loops closed, with the same body momentum.

    Returns:
        The velocity (n,), the impetus (m,) for random multipliers, and the multipliers (k,).
    """
    r = system.r
    if system.closure is None:
        return v, H[r:] @ v, np.empty(0)
    J = np.zeros((system.closure.rank, len(v)))
    J[:, r:] = loop_jacobian(system, x)[system.closure.rows]
    response = np.linalg.solve(H, J.T)
    # Multipliers of this size have impulses of the size of the momenta, in every unit.
    nu = np.linalg.solve(J @ response, J @ v)
    v = v - response @ nu
    nu *= rng.uniform(0.5, 2.0, len(nu))
    return v, (H @ v + J.T @ nu)[r:], nu


def impetus_terms(system: System, x: Array, xdot: Array, nu: Array) -> Array:
    """Return ṗ less the rates of the canonical momenta and less Jᵀν̇, (m,); see LoopTerms."""
    if system.closure is None:
        return np.zeros(system.m)
    rows = system.closure.rows
    rate = loop_jacobian_rate(system, x, xdot)[rows]
    return np.asarray((rate - GAUGE_RATE * loop_jacobian(system, x)[rows]).T @ nu)


def closed_solver(
    system: System, x: Array, xdot: Array, inertia: Array
) -> Callable[[Array], Array]:
    """Return the map from generalised forces to accelerations that keep loops closed."""
    if system.closure is None:
        return lambda force: np.asarray(np.linalg.solve(inertia, force))
    r, rows = system.r, system.closure.rows
    J = np.zeros((len(rows), len(inertia)))
    J[:, r:] = loop_jacobian(system, x)[rows]
    bias = loop_jacobian_rate(system, x, xdot)[rows] @ xdot
    response = np.linalg.solve(inertia, J.T)

    def solve(force: Array) -> Array:
        free = np.linalg.solve(inertia, force)
        return np.asarray(free - response @ np.linalg.solve(J @ response, J @ free + bias))

    return solve
