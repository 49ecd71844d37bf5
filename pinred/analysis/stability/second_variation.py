"""Definiteness of the second variation at a relative equilibrium, transverse to its family.

The second variation of the energy–momentum function has two blocks. One is the Hessian of the
amended potential on shapes × directions. The other is the reduced kinetic energy, which is
positive. If both are positive definite, the equilibrium is stable. A body without joints has only
the first block, so that a maximum is stable, too.

Under gravity, a pivoted body conserves its momentum about the vertical. An upright spinning
("sleeping") top is stable, but it is not a minimum of the amended potential. A top that is
symmetric about a body axis a through the pivot also conserves μ·a. The same holds with cyclic
rotors. Let b be the base, c the cyclic and d the driven rotors. With K = H_bb − H_bc H_cc⁻¹ H_cb,
the effective inertia, and k, the momentum of the rotors while the body is at rest, the energy is

    h(Γ, μ) = ½ (μ − k)ᵀ K⁻¹ (μ − k) − m |g| c·Γ,     k = H_bd ν + H_bc H_cc⁻¹ (π − H_cd ν),

for momenta π of the cyclic rotors and rates ν of the driven rotors.

Sources: J. C. Simo, D. Lewis, J. E. Marsden, "Stability of relative equilibria. Part I: The reduced
energy–momentum method", 1991; D. Lewis, T. Ratiu, J. C. Simo, J. E. Marsden, "The heavy top: a
geometric treatment", Nonlinearity 5, 1992.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...common.arrays import Array, FrozenArrays
from ...lie.rotations import hat
from ...reduction.inertia_split import mass_matrix
from ...reduction.tree.second_derivatives import inertia_derivatives
from ..equilibria.amended_energy import AmendedEnergy
from ..equilibria.equilibrium_problem import Problem
from ..equilibria.points import Points, tangents
from ..equilibria.search import critical_points, residuals

_NULL = 1e-7  # curvature below which a direction is flat, relative to the largest
_FAMILY_STEP = 0.1  # displacement along a flat direction that tests for a family [rad | m]
_SAME_ENERGY = 1e-9  # largest relative difference of energies within one family
_SYMMETRIC = 1e-12  # largest asymmetry of a symmetric body, relative to its inertia
_CRITICAL = 1e-8  # largest residual of the critical-point equations, relative to dh
_RANK = 1e-10  # singular value below which a matrix loses rank, relative to the largest
_DEFINITE = 1e-14  # least eigenvalue of a definite matrix, relative to its largest entry
_REACH = 1e3  # bound of the multipliers in the search, relative to the body's rate


@dataclass(frozen=True)
class SecondVariation(FrozenArrays):
    """Curvatures of the amended potential at an equilibrium. Arrays are read-only.

    Attributes:
        values: Eigenvalues of the Hessian relative to the kinetic metric, (u,) [1/s²].
        dimension: Dimension of the family of equilibria.
        index: Number of negative curvatures transverse to the family.
        definite: Whether the second variation is definite transverse to the family.
    """

    values: Array
    dimension: int
    index: int
    definite: bool


def second_variation(energy: AmendedEnergy, point: Points, J: float) -> SecondVariation:
    """Compute the second variation at one equilibrium.

    Args:
        energy: Amended potential of the problem.
        point: The equilibrium, a Points of length one.
        J: Momentum.
    Returns:
        The curvatures of the amended potential and their signs.
    """
    problem = energy.problem
    e = energy(point, J)
    W = weights(problem, point)
    values, vectors = np.linalg.eigh(W @ e.hessian[0] @ W)
    largest = float(np.abs(values).max(initial=0.0))
    # The energy of a rigid body may be constant; its computed curvatures are then only round-off.
    floor = max(_NULL * largest, 1e-13 * float(e.scale[0]) * float(np.max(W, initial=0.0)) ** 2)
    flat = np.abs(values) <= floor
    dimension = _family_dimension(energy, point, J, W @ vectors[:, flat]) if flat.any() else 0
    transverse = values[~flat] if dimension == int(flat.sum()) else values
    index = int((transverse < -floor).sum())
    positive = bool((transverse > floor).all())
    # A free body without joints changes only its direction; under gravity it also swings.
    negative = bool((transverse < -floor).all()) and not problem.active and problem.kind == "free"
    definite = positive or negative
    if not definite and problem.kind == "heavy" and not problem.active:
        definite = is_definite_with_axis_momentum(heavy_top(problem, J), point.n[0], J)
    return SecondVariation(values, dimension, index, definite)


def weights(problem: Problem, point: Points) -> Array:
    """Return the matrix W whose square is the inverse of the kinetic metric on the unknowns.

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
    on_shape = H[np.ix_(active_indices, active_indices)] - coupling.T @ np.linalg.solve(K, coupling)
    if problem.surface is not None:
        N = problem.surface.tangents(point.x)[0][0]
        on_shape, ma = N.T @ on_shape @ N, N.shape[1]
    metric = np.zeros((problem.unknowns, problem.unknowns))
    metric[:ma, :ma] = on_shape
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
        difference = point.difference(neighbour)
        is_distinct = float(np.linalg.norm(difference)) > 0.5 * _FAMILY_STEP
        has_same_energy = abs(float(energies.U[0] - initial.U[0])) <= _SAME_ENERGY * float(
            initial.scale[0]
        )
        count += bool(is_distinct and has_same_energy and residuals(energies)[0] <= 1e-9)
    return count


@dataclass(frozen=True)
class HeavyTop(FrozenArrays):
    """A body on a pivot under gravity, with steadily spinning rotors. Arrays are read-only.

    Attributes:
        inertia: Effective inertia K, (3, 3) [kg m²].
        offset: Momentum k of the rotors, (3,) [N m s].
        com: Centre of mass c in the body, (3,) [m].
        weight: Gravity force m |g| [N].
        scales: Typical sizes of (Γ, μ), (6,).
        rate: Typical rate of the body [rad/s].
    """

    inertia: Array
    offset: Array
    com: Array
    weight: float
    scales: Array
    rate: float

    @property
    def axis(self) -> Array | None:
        """The common symmetry axis (3,) of inertia, centre of mass and rotors, or None."""
        axis = self.com / np.linalg.norm(self.com)
        inertia_asymmetry = np.abs(hat(axis) @ self.inertia - self.inertia @ hat(axis)).max()
        offset_asymmetry = np.abs(np.cross(axis, self.offset)).max()
        if inertia_asymmetry > _SYMMETRIC * np.abs(self.inertia).max():
            return None
        return None if offset_asymmetry > _SYMMETRIC * self.scales[3] else axis


def heavy_top(problem: Problem, J: float) -> HeavyTop:
    """Return the top that corresponds to a problem without active joints.

    Args:
        problem: Problem of a pivoted body under gravity.
        J: Momentum about the vertical [N m s], which sets the typical momentum.
    Returns:
        The top.
    """
    system, cyclic = problem.system, list(problem.cyclic)
    derivatives = inertia_derivatives(system, problem.shapes(np.zeros((1, 0))), of=())
    H, c = derivatives.H[0], derivatives.com[0]
    spin_indices = [3 + k for k in cyclic]
    H_bc, H_cc = H[:3, spin_indices], H[np.ix_(spin_indices, spin_indices)]
    driven_indices = [3 + k for k in problem.driven]
    momenta = problem.cyclic_momenta - H[np.ix_(spin_indices, driven_indices)] @ problem.driven_rate
    K = H[:3, :3] - H_bc @ np.linalg.solve(H_cc, H_bc.T)
    offset = H[:3][:, driven_indices] @ problem.driven_rate + H_bc @ np.linalg.solve(H_cc, momenta)
    weight = system.mass * float(np.linalg.norm(system.gravity))
    least_inertia, largest_inertia = np.linalg.eigvalsh(K)[[0, -1]]
    torque = weight * float(np.linalg.norm(c))
    momentum = abs(J) + float(np.linalg.norm(offset)) + float(np.sqrt(largest_inertia * torque))
    scales = np.repeat([1.0, momentum], 3)
    return HeavyTop(K, offset, c, weight, scales, momentum / float(least_inertia))


def is_definite_with_axis_momentum(top: HeavyTop, up: Array, J: float) -> bool:
    """Return whether the momentum about the symmetry axis makes a steady motion stable.

    With z = (Γ, μ) and Γ = −up, the test takes the second variation of
    h − λ₁ μ·Γ − λ₂ ½|Γ|² − κ μ·a on the leaf with constant μ·a. It tries all multipliers for which
    the equilibrium is a critical point.

    Args:
        top: The body.
        up: Upward vertical in the body, (3,).
        J: Momentum about the vertical [N m s].
    Returns:
        True if the second variation is definite for some multipliers.
    """
    axis = top.axis
    if axis is None:
        return False
    D, K, gamma = top.scales, top.inertia, -up
    omega = (J - float(up @ top.offset)) / float(up @ K @ up) * up
    mu = K @ omega + top.offset
    dh = D * np.concatenate([-top.weight * top.com, omega])
    constraint_gradients = D * np.array(
        [np.r_[mu, gamma], np.r_[gamma, np.zeros(3)], np.r_[np.zeros(3), axis]]
    )
    multipliers = np.linalg.lstsq(constraint_gradients.T, dh, rcond=None)[0]
    if np.linalg.norm(constraint_gradients.T @ multipliers - dh) > _CRITICAL * np.linalg.norm(dh):
        return False
    _, singular, right = np.linalg.svd(constraint_gradients.T)
    is_upright = singular[2] <= _RANK * singular[0]  # If upright, one multiplier is free.
    multiplier_direction = right[2] / right[2][0] if is_upright else np.zeros(3)
    axis_rotation = np.concatenate([np.cross(axis, gamma), np.cross(axis, mu)]) / D
    constraints = (
        np.vstack([constraint_gradients, axis_rotation])
        if np.linalg.norm(axis_rotation) > _RANK
        else constraint_gradients
    )
    _, singular, right = np.linalg.svd(constraints)
    B = right[int((singular > _RANK * singular[0]).sum()) :].T

    def quadratic(multiplier: float) -> Array:
        lambda_1, lambda_2, _ = multipliers + multiplier * multiplier_direction
        hessian = np.block(
            [
                [-lambda_2 * np.eye(3), -lambda_1 * np.eye(3)],
                [-lambda_1 * np.eye(3), np.linalg.inv(K)],
            ]
        )
        return np.asarray(B.T @ (D[:, None] * hessian * D) @ B)

    return _is_definite(quadratic, _REACH * top.rate if is_upright else 0.0)


def _is_definite(quadratic: Callable[[float], Array], reach: float) -> bool:
    """Return whether a multiplier in [−reach, reach] makes a quadratic form definite."""
    from scipy.optimize import minimize_scalar

    for sign in (1.0, -1.0):  # The least eigenvalue is concave in the multiplier.
        multiplier = 0.0
        if reach:
            multiplier = minimize_scalar(
                lambda k, s=sign: -np.linalg.eigvalsh(s * quadratic(k))[0],
                bounds=(-reach, reach), method="bounded", options={"xatol": 1e-12 * reach},
            ).x  # fmt: skip
        matrix = sign * quadratic(multiplier)
        if np.linalg.eigvalsh(matrix)[0] > _DEFINITE * np.abs(matrix).max():
            return True
    return False
