"""Closed loops in the validation of kernels, with Jacobians by Pinocchio."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..common.arrays import Array
from ..reduction.tree.loop_constraints import GAUGE_RATE
from ..system.loops.looped_system import loop_jacobian, loop_jacobian_rate

if TYPE_CHECKING:
    from ..system.system import System


def with_closed_loops(
    system: System,
    x: Array,
    H: Array,
    v: Array,
    rng: np.random.Generator,
    prescribed: Sequence[int] = (),
) -> tuple[Array, Array, Array]:
    """Project v on velocities that keep loops closed, with the same body momentum.

    Rates of prescribed joints do not change.

    Returns:
        The velocity (n,), the impetus (m,) for random multipliers, and the multipliers (k,).
    """
    r = system.r
    if system.closure is None:
        return v, H[r:] @ v, np.empty(0)
    J = np.zeros((system.closure.rank, len(v)))
    J[:, r:] = loop_jacobian(system, x)[system.closure.rows]
    free = np.setdiff1d(np.arange(len(v)), r + np.array(prescribed, dtype=int))
    response = np.linalg.solve(H[np.ix_(free, free)], J[:, free].T)
    # Multipliers of this size have impulses of the size of the momenta, in every unit.
    mobility = J[:, free] @ response
    nu: Array = np.asarray(np.linalg.solve(mobility, J @ v))
    v = v.copy()
    v[free] -= response @ nu
    v[free] -= response @ np.linalg.solve(mobility, J @ v)  # Round-off moves light links.
    nu = nu * rng.uniform(0.5, 2.0, len(nu))
    return v, (H @ v + J.T @ nu)[r:], nu


def impetus_terms(system: System, x: Array, xdot: Array, nu: Array) -> Array:
    """Return ṗ less the rates of the canonical momenta and less Jᵀν̇, (m,); see LoopTerms."""
    if system.closure is None:
        return np.zeros(system.m)
    rows = system.closure.rows
    rate = loop_jacobian_rate(system, x, xdot)[rows]
    return np.asarray((rate - GAUGE_RATE * loop_jacobian(system, x)[rows]).T @ nu)


def closed_solver(
    system: System, x: Array, xdot: Array, inertia: Array, prescribed: Sequence[int], a: Array
) -> Callable[[Array], Array]:
    """Return the map from generalised forces to accelerations that keep loops closed.

    Args:
        system: The system.
        x: Shape, (nx,).
        xdot: Shape rate, (m,).
        inertia: Mass matrix without the rows and columns of prescribed joints.
        prescribed: Indices of the prescribed joints.
        a: Accelerations of the prescribed joints.
    """
    if system.closure is None:
        return lambda force: np.asarray(np.linalg.solve(inertia, force))
    r, rows = system.r, system.closure.rows
    on_shape = loop_jacobian(system, x)[rows]
    bias = loop_jacobian_rate(system, x, xdot)[rows] @ xdot + on_shape[:, list(prescribed)] @ a
    J = np.zeros((len(rows), len(inertia)))
    J[:, r:] = np.delete(on_shape, list(prescribed), axis=1)
    response = np.linalg.solve(inertia, J.T)

    def solve(force: Array) -> Array:
        free = np.linalg.solve(inertia, force)
        return np.asarray(free - response @ np.linalg.solve(J @ response, J @ free + bias))

    return solve
