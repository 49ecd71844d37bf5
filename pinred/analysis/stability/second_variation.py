"""Definiteness of the second variation at a relative equilibrium, across the family it is in.

The Hessian of the amended potential on shapes × directions is one block of the second variation of
the energy–momentum function, the reduced kinetic energy the other, which is positive: where both
are positive definite, the motion stays close for ever.  A body without joints has no other block,
so that a maximum is as good as a minimum.  Where gravity turns a body that is symmetric about an
axis of its own, with rotors or without, the momentum about it is kept too (`own_axis.py`).

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
from .own_axis import definite_with_own_axis, heavy_top

_NULL = 1e-7  # of the largest curvature; below it a direction is flat
_ALONG = 0.1  # rad | m, how far a family is followed to see that it is one
_SAME = 1e-9  # of the size of the energies; equilibria of one family have the same


@dataclass(frozen=True)
class SecondVariation:
    """Curvatures of the amended potential at an equilibrium.

    values: (u,) of its Hessian, in units of the kinetic energy [1/s²].  dimension: of the family
    of equilibria.  index: number of negative curvatures across it.  definite: whether the second
    variation is, across the family.
    """

    values: Array
    dimension: int
    index: int
    definite: bool

    def __post_init__(self) -> None:
        freeze(self)


def second_variation(energy: AmendedEnergy, point: Points, J: float) -> SecondVariation:
    """Return the second variation at one equilibrium, a Points of length one."""
    problem = energy.problem
    e = energy(point, J)
    W = weights(problem, point)
    values, vectors = np.linalg.eigh(W @ e.hessian[0] @ W)
    largest = float(np.abs(values).max(initial=0.0))
    # What round-off leaves of a rigid body's energy, where there is nothing else.
    floor = max(_NULL * largest, 1e-13 * float(e.scale[0]) * float(np.max(W, initial=0.0)) ** 2)
    flat = np.abs(values) <= floor
    dimension = _family(energy, point, J, W @ vectors[:, flat]) if flat.any() else 0
    rest = values[~flat] if dimension == int(flat.sum()) else values
    index = int((rest < -floor).sum())
    positive = bool((rest > floor).all())
    # A free body without joints has nothing but its direction; a heavy one swings about it.
    negative = bool((rest < -floor).all()) and not problem.active and problem.kind == "free"
    definite = positive or negative
    if not definite and problem.kind == "heavy" and not problem.active:
        definite = definite_with_own_axis(heavy_top(problem, J), point.n[0], J)
    return SecondVariation(values, dimension, index, definite)


def weights(problem: Problem, point: Points) -> Array:
    """Return W with W² the inverse of a metric on the unknowns: the kinetic one, and of turns."""
    ma, system = len(problem.active), problem.system
    rows = [*range(system.r), *(system.r + k for k in problem.cyclic)]
    active = [system.r + k for k in problem.active]
    H = mass_matrix(system, problem.shapes(point.x)[0])
    K, side = H[np.ix_(rows, rows)], H[np.ix_(rows, active)]
    metric = np.zeros((problem.unknowns, problem.unknowns))
    metric[:ma, :ma] = H[np.ix_(active, active)] - side.T @ np.linalg.solve(K, side)
    if problem.directional:
        T = tangents(point.n)[0]
        I = K[system.r - 3 : system.r, system.r - 3 : system.r]
        metric[ma:, ma:] = T.T @ I @ T
    values, vectors = np.linalg.eigh(metric)
    return np.asarray((vectors / np.sqrt(values)) @ vectors.T)


def _family(energy: AmendedEnergy, point: Points, J: float, flat: Array) -> int:
    """Return in how many of the flat directions (u, k), each in a column, equilibria go on."""
    here = energy(point, J)
    count = 0
    for direction in (flat / np.linalg.norm(flat, axis=0)).T:
        there, e = critical_points(energy, point.moved(_ALONG * direction[None]), J)
        if not len(there):
            continue
        apart = np.concatenate([there.x - point.x, there.n - point.n], axis=1)
        gone = float(np.linalg.norm(apart)) > 0.5 * _ALONG
        same = abs(float(e.U[0] - here.U[0])) <= _SAME * float(here.scale[0])
        count += bool(gone and same and residuals(e)[0] <= 1e-9)
    return count
