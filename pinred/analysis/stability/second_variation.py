"""Definiteness of the second variation at a relative equilibrium, across the family it is in.

The Hessian of the amended potential on shapes × directions is one block of the second variation of
the energy–momentum function, the reduced kinetic energy the other, which is positive: where both
are positive definite, the motion stays close for ever.  A body without joints has no other block,
so that a maximum is as good as a minimum.  Where gravity turns a rigid body that is symmetric about
an axis of its own, the momentum about that axis is kept too, and may be added with any factor.

Source: J. C. Simo, D. Lewis, J. E. Marsden, "Stability of relative equilibria. Part I: The reduced
energy–momentum method", 1991.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...common.arrays import Array, freeze
from ...lie.rotations import hat
from ...reduction.inertia_split import mass_matrix
from ...reduction.tree.second_derivatives import inertia_derivatives
from ..equilibria.amended_energy import AmendedEnergy, Points, tangents
from ..equilibria.problem import Problem
from ..equilibria.search import critical_points, residuals

_NULL = 1e-7  # of the largest curvature; below it a direction is flat
_ALONG = 0.1  # rad | m, how far a family is followed to see that it is one
_SAME = 1e-9  # of the size of the energies; equilibria of one family have the same
_SYMMETRIC = 1e-12  # of the inertia, by which a body may miss being symmetric


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
    if not definite and problem.kind == "heavy" and not problem.active and not problem.cyclic:
        definite = definite_with_own_axis(problem, point.n[0], J)
    return SecondVariation(values, dimension, index, definite)


def definite_with_own_axis(problem: Problem, up: Array, J: float) -> bool:
    """Return whether the momentum about a heavy rigid body's own axis makes the motion stable.

    up: (3,) the upward vertical in the body.  In z = (Γ, μ), Γ = −up, the second variation of
    h − λ₁ μ·Γ − λ₂ ½|Γ|² − κ μ·a on the leaf, where μ·a is constant, is tried for all κ that leave
    the equilibrium critical.
    """
    from scipy.optimize import minimize_scalar

    system = problem.system
    d = inertia_derivatives(system, np.zeros((1, system.m)))
    I, c = d.H[0], d.com[0]
    axis = symmetry_axis(I, c)
    if axis is None:
        return False
    weight = system.mass * float(np.linalg.norm(system.gravity))
    gamma = -up
    omega = J / float(up @ I @ up) * up
    mu = I @ omega
    slope_h = np.concatenate([-weight * c, omega])
    slopes = np.array([np.r_[mu, gamma], np.r_[gamma, np.zeros(3)], np.r_[np.zeros(3), axis]]).T
    first = np.linalg.lstsq(slopes, slope_h, rcond=None)[0]
    if np.linalg.norm(slopes @ first - slope_h) > 1e-8 * np.linalg.norm(slope_h):
        return False
    _, singular, right = np.linalg.svd(slopes)
    free = right[2] if singular[2] <= 1e-10 * singular[0] else np.zeros(3)
    turn = np.concatenate([np.cross(axis, gamma), np.cross(axis, mu)])  # about the own axis
    rows = np.vstack([slopes.T, turn]) if np.linalg.norm(turn) > 1e-10 else slopes.T
    _, singular, right = np.linalg.svd(rows)
    B = right[int((singular > 1e-10 * singular[0]).sum()) :].T

    def quadratic(kappa: float) -> Array:
        one, two, _ = first + kappa * free
        whole = np.block(
            [[-two * np.eye(3), -one * np.eye(3)], [-one * np.eye(3), np.linalg.inv(I)]]
        )
        return np.asarray(B.T @ whole @ B)

    if not free.any():
        values = np.linalg.eigvalsh(quadratic(0.0))
        return bool((values > 0).all() or (values < 0).all())
    reach = 1e3 * (1.0 + float(np.linalg.norm(omega)))
    for sign in (1.0, -1.0):  # the least eigenvalue is concave in κ
        best = minimize_scalar(
            lambda k, s=sign: -np.linalg.eigvalsh(s * quadratic(k))[0],
            bounds=(-reach, reach),
            method="bounded",
            options={"xatol": 1e-10},
        )
        size = float(np.abs(quadratic(best.x)).max())
        if -best.fun > 1e-14 * size:
            return True
    return False


def symmetry_axis(I: Array, c: Array) -> Array | None:
    """Return the axis about which an inertia (3, 3) and a centre of mass are symmetric, or None."""
    values, vectors = np.linalg.eigh(I)
    for k in range(3):
        axis = vectors[:, k]
        if np.linalg.norm(c) > 0.0:
            axis = c / np.linalg.norm(c)
        turned = hat(axis) @ I - I @ hat(axis)
        if np.abs(turned).max() <= _SYMMETRIC * values[-1]:
            return np.asarray(axis)
    return None


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
