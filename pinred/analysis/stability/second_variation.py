"""Definiteness of the second variation at a relative equilibrium, transverse to its family.

The second variation of the energy–momentum function has two blocks. One is the Hessian of the
amended potential on shapes × directions. The other is the reduced kinetic energy, which is
positive. If both are positive definite, the equilibrium is stable. A body without joints has only
the first block, so that a maximum is stable, too. A heavy body that is symmetric about an axis,
with or without rotors, also conserves its momentum about that axis (`symmetric_top.py`).

Source: J. C. Simo, D. Lewis, J. E. Marsden, "Stability of relative equilibria. Part I: The reduced
energy–momentum method", 1991.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...common.arrays import Array, freeze
from ...reduction.inertia_split import mass_matrix
from ..equilibria.amended_energy import AmendedEnergy, Points, tangents
from ..equilibria.problem import Problem
from ..equilibria.search import critical_points, residuals
from .symmetric_top import heavy_top, is_definite_with_axis_momentum

_NULL = 1e-7  # relative to the largest curvature; below it a direction is flat
_FAMILY_STEP = 0.1  # rad | m, displacement along a flat direction that tests for a family
_SAME_ENERGY = 1e-9  # largest relative difference of energies within one family


@dataclass(frozen=True)
class SecondVariation:
    """Curvatures of the amended potential at an equilibrium. Arrays are read-only.

    Attributes:
        values: Eigenvalues of its Hessian relative to the kinetic metric, (u,) [1/s²].
        dimension: Dimension of the family of equilibria.
        index: Number of negative curvatures transverse to the family.
        definite: Whether the second variation is definite transverse to the family.
    """

    values: Array
    dimension: int
    index: int
    definite: bool

    def __post_init__(self) -> None:
        freeze(self)


def second_variation(energy: AmendedEnergy, point: Points, J: float) -> SecondVariation:
    """Compute the second variation at one equilibrium.

    Args:
        energy: Amended potential of the problem.
        point: The equilibrium, a Points of length one.
        J: Momentum.
    Returns:
        Its curvatures and their signs.
    """
    problem = energy.problem
    e = energy(point, J)
    W = weights(problem, point)
    values, vectors = np.linalg.eigh(W @ e.hessian[0] @ W)
    largest = float(np.abs(values).max(initial=0.0))
    # The energy of a rigid body may be constant, and its curvatures round-off only.
    floor = max(_NULL * largest, 1e-13 * float(e.scale[0]) * float(np.max(W, initial=0.0)) ** 2)
    flat = np.abs(values) <= floor
    dimension = _family_dimension(energy, point, J, W @ vectors[:, flat]) if flat.any() else 0
    transverse = values[~flat] if dimension == int(flat.sum()) else values
    index = int((transverse < -floor).sum())
    positive = bool((transverse > floor).all())
    # A free body without joints changes only its direction; a heavy one also swings about it.
    negative = bool((transverse < -floor).all()) and not problem.active and problem.kind == "free"
    definite = positive or negative
    if not definite and problem.kind == "heavy" and not problem.active:
        definite = is_definite_with_axis_momentum(heavy_top(problem, J), point.n[0], J)
    return SecondVariation(values, dimension, index, definite)


def weights(problem: Problem, point: Points) -> Array:
    """Return W whose square is the inverse of the kinetic metric on the unknowns.

    The metric on directions is the locked inertia.

    Args:
        problem: Problem of the relative equilibria.
        point: One point, a Points of length one.
    Returns:
        (u, u), symmetric.
    """
    ma, system = len(problem.active), problem.system
    group_indices = [*range(system.r), *(system.r + k for k in problem.cyclic)]
    active_indices = [system.r + k for k in problem.active]
    H = mass_matrix(system, problem.shapes(point.x)[0])
    K, coupling = H[np.ix_(group_indices, group_indices)], H[np.ix_(group_indices, active_indices)]
    metric = np.zeros((problem.unknowns, problem.unknowns))
    metric[:ma, :ma] = H[np.ix_(active_indices, active_indices)] - coupling.T @ np.linalg.solve(
        K, coupling
    )
    if problem.directional:
        T = tangents(point.n)[0]
        I = K[system.r - 3 : system.r, system.r - 3 : system.r]
        metric[ma:, ma:] = T.T @ I @ T
    values, vectors = np.linalg.eigh(metric)
    return np.asarray((vectors / np.sqrt(values)) @ vectors.T)


def _family_dimension(energy: AmendedEnergy, point: Points, J: float, flat: Array) -> int:
    """Count the flat directions (u, k), one per column, that lead to other equilibria."""
    initial = energy(point, J)
    count = 0
    for direction in (flat / np.linalg.norm(flat, axis=0)).T:
        neighbour, energies = critical_points(
            energy, point.moved(_FAMILY_STEP * direction[None]), J
        )
        if not len(neighbour):
            continue
        difference = np.concatenate([neighbour.x - point.x, neighbour.n - point.n], axis=1)
        is_distinct = float(np.linalg.norm(difference)) > 0.5 * _FAMILY_STEP
        has_same_energy = abs(float(energies.U[0] - initial.U[0])) <= _SAME_ENERGY * float(
            initial.scale[0]
        )
        count += bool(is_distinct and has_same_energy and residuals(energies)[0] <= 1e-9)
    return count
