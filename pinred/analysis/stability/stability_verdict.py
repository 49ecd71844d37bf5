"""The verdict on a relative equilibrium: stable, unstable or undecided, and its reasons.

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

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array, FrozenArrays
from ...kernels.kernel import Layout
from ...lie.rotations import hat
from ...reduction.pointwise_reduction import mass_matrix
from ...reduction.tree.second_derivatives import inertia_derivatives
from ...system.coordinates import ShapeSpace
from ...system.joints import BALL
from ..equilibria.amended_potential import AmendedEnergy, critical_points, residuals
from ..equilibria.equilibrium_problem import Points, Problem, tangents
from .linearised_flow import Linearisation, eigen, eigenvalue_errors, norm

Verdict: TypeAlias = Literal["stable", "unstable", "undecided"]
_SIGNIFICANT = 10.0  # growth rates above this multiple of their error count as unstable
_ROUND_OFF = 1e-14  # error of the matrix, relative to its norm
_NEAR_ZERO = 1e-4  # largest split of a double eigenvalue at zero, relative to the norm
_NO_GROWTH = 1e-9  # largest growth of an undamped oscillation, relative to the norm


@dataclass(frozen=True, eq=False)
class Mode(FrozenArrays):
    """A mode δz = Re(amplitude e^{λt}) of the linearised reduced flow. Arrays are read-only.

    Amplitudes are scaled so that the largest shape amplitude is 1; if all shape
    amplitudes are zero, the largest entry is 1.

    Attributes:
        growth: Re λ [1/s].
        error: Error of λ [1/s].
        frequency: Im λ [rad/s].
        shape: Complex amplitudes of x along the frame of the shape, (m,), zero for joints that are
            not active.
        momentum: Complex amplitudes of π, (m,), zero for joints that are not active.
        base: Complex amplitudes of the base entries of the reduced state.
    """

    growth: float
    error: float
    frequency: float
    shape: NDArray[np.complex128]
    momentum: NDArray[np.complex128]
    base: NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class Stability:
    """The stability of a relative equilibrium.

    Attributes:
        verdict: "stable" (definite second variation), "unstable" (a growth rate well above its
            error), or "undecided".
        growth: Largest Re λ [1/s]; zero if none is significant.
        growth_error: Error of the eigenvalue with the largest growth [1/s].
        frequencies: Frequencies of undamped oscillations, (k,) [rad/s], sorted.
        modes: Modes, one of each conjugate pair, largest growth first.
        index: Number of negative curvatures of the amended potential.
        dimension: Dimension of the family of equilibria.
        growing: Number of growing modes with real λ.
        damped_growth: For an undecided verdict, the largest ∂Re λ/∂c over all modes for a damper −c
            ẋ, by joint name, or by axis for a ball.
    """

    verdict: Verdict
    growth: float
    growth_error: float
    frequencies: Array
    modes: tuple[Mode, ...]
    index: int
    dimension: int
    growing: int
    damped_growth: Mapping[str, float]


def assess_stability(
    linear: Linearisation, second: SecondVariation, layout: Layout, space: ShapeSpace
) -> Stability:
    """Decide stability from the linearised flow and the second variation.

    Args:
        linear: Linearised flow at the equilibrium.
        second: Second variation of the amended potential.
        layout: Layout of the kernel of the flow.
        space: Manifold of the shape.
    Returns:
        The verdict, its reasons, and the modes.
    """
    leaf, entries = linear.leaf, _shape_entries(linear, layout)
    on_leaf = leaf.restrict(linear.matrix)
    values, left_vectors, right = eigen(on_leaf)
    errors = eigenvalue_errors(left_vectors, right, _ROUND_OFF * norm(on_leaf))
    is_transverse = np.ones(len(values), dtype=bool)
    if second.dimension:
        # Each direction of the family adds a double eigenvalue at zero.  If its symmetries do not
        # commute, as rotations of a spherical rotor, fewer eigenvalues are zero.
        nearest = np.argsort(np.abs(values))[: 2 * second.dimension]
        is_transverse[nearest] = np.abs(values[nearest]) > _NEAR_ZERO * norm(on_leaf)
    values, errors = values[is_transverse], errors[is_transverse]
    left_vectors, right = left_vectors[:, is_transverse], right[:, is_transverse]
    growths = values.real
    is_significant = growths > _SIGNIFICANT * errors
    unstable, top = bool(is_significant.any()), None
    if len(growths):
        top = int(np.argmax(np.where(is_significant, growths, -np.inf) if unstable else growths))
    verdict: Verdict = "unstable" if unstable else "stable" if second.definite else "undecided"
    modes = tuple(
        _mode(value, error, leaf.embed(vector), entries, space.m)
        for value, error, vector in zip(values, errors, right.T, strict=True)
        if value.imag > 0.0 or (value.imag == 0.0 and value.real >= 0.0)
    )
    is_undamped = (values.imag > 0.0) & (
        np.abs(growths) <= _SIGNIFICANT * np.maximum(errors, _NO_GROWTH * norm(on_leaf))
    )
    return Stability(
        verdict=verdict,
        growth=float(growths[top]) if top is not None and is_significant[top] else 0.0,
        growth_error=float(errors[top]) if top is not None else 0.0,
        frequencies=np.sort(values.imag[is_undamped]),
        modes=modes,
        index=second.index,
        dimension=second.dimension,
        growing=int((is_significant & (values.imag == 0.0)).sum()),
        damped_growth=(
            _damped_growth(linear, values, left_vectors, right, entries, space.names)
            if verdict == "undecided"
            else {}
        ),
    )


@dataclass(frozen=True, eq=False)
class _ShapeEntries(FrozenArrays):
    """The active rates among the entries z of the reduced state.

    Attributes:
        rates: Indices of the active rates, (a,).
        displacements: Map from δz to displacements along the frame of the shape, (a, k).
        momenta: Indices in z of the momenta of the active rates, (a,).
        base: Index in z of the first entry of the base.
    """

    rates: NDArray[np.intp]
    displacements: Array
    momenta: NDArray[np.intp]
    base: int


def _shape_entries(linear: Linearisation, layout: Layout) -> _ShapeEntries:
    leaf, active = linear.leaf, layout.active
    rates, momenta = [*active, *layout.ball_v], [*range(leaf.momenta.start, leaf.momenta.stop)]
    displacements = np.zeros((len(rates), len(linear.state)))
    displacements[: len(active), leaf.places] = np.eye(len(active))
    first = len(active)
    for k, entries in enumerate(leaf.quaternions):
        momenta += range(leaf.momenta.stop + 3 * k, leaf.momenta.stop + 3 * k + 3)
        E = BALL.rate_map(linear.state[entries])
        displacements[first : first + 3, entries] = 4.0 * E.T
        first += 3
    base = leaf.quaternions[-1].stop if leaf.quaternions else leaf.momenta.stop
    return _ShapeEntries(
        np.array(rates, dtype=np.intp), displacements, np.array(momenta, dtype=np.intp), base
    )


def _mode(
    value: complex,
    error: float,
    amplitudes: NDArray[np.complex128],
    entries: _ShapeEntries,
    count: int,
) -> Mode:
    """Return one mode, scaled so that its largest shape amplitude is 1.

    Args:
        value: Eigenvalue [1/s].
        error: Error of the eigenvalue [1/s].
        amplitudes: Eigenvector, (k,).
        entries: Active rates among the entries of the reduced state.
        count: Number of all rates.
    Returns:
        The mode.
    """
    shape, momentum = np.zeros((2, count), dtype=complex)
    displacements = entries.displacements @ amplitudes
    candidates = (
        displacements
        if np.abs(displacements).max(initial=0.0) > 1e-12 * np.abs(amplitudes).max()
        else amplitudes
    )
    scale = candidates[int(np.argmax(np.abs(candidates)))]
    amplitudes = amplitudes / scale
    shape[entries.rates] = displacements / scale
    momentum[entries.rates] = amplitudes[entries.momenta]
    base = amplitudes[entries.base :]
    return Mode(value.real, float(error), value.imag, shape, momentum, base.copy())


def _damped_growth(
    linear: Linearisation,
    values: NDArray[np.complex128],
    left: NDArray[np.complex128],
    right: NDArray[np.complex128],
    entries: _ShapeEntries,
    names: tuple[str, ...],
) -> dict[str, float]:
    """Compute the largest ∂Re λ/∂c for a damper −c ẋ at each active joint.

    The active joints are at rest, so their rates change by the map of displacements times δż.

    Args:
        linear: Linearised flow.
        values: Eigenvalues, (d,).
        left: Left eigenvectors, one per column.
        right: Right eigenvectors, one per column.
        entries: Active rates among the entries of the reduced state.
        names: Names of all rates.
    Returns:
        Largest derivative over all modes, by joint name [1/s per N m s/rad].
    """
    leaf, growth_by_joint = linear.leaf, {}
    for i, k in enumerate(entries.rates.tolist()):
        change = np.zeros_like(linear.matrix)
        change[entries.momenta[i]] = -entries.displacements[i] @ linear.matrix
        numerator = np.einsum("ij,ik,kj->j", left.conj(), leaf.restrict(change), right)
        eigenvalue_rates = numerator / np.einsum("ij,ij->j", left.conj(), right)
        growth_by_joint[names[k]] = (
            float(eigenvalue_rates.real.max(initial=-np.inf)) if len(values) else 0.0
        )
    return growth_by_joint


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
