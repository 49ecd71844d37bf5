"""The reduced equations of motion, term by term, evaluated with Pinocchio.

No engine uses this module: the engines integrate the canonical form (canonical_form.py).

The Lagrange–Poincaré equations, in shape x, rate ẋ and locked velocity Ω, with μ = I Ω and
ξ = Ω − A ẋ:

    d/dt(M ẋ)_α = ½ ẋᵀ ∂_αM ẋ + ½ Ωᵀ ∂_αI Ω − ∂_αV + ⟨μ, B_αβ⟩ ẋ^β − ⟨μ, [Ω, A_α]⟩ + τ_α
                      − ⟨f, A_α⟩
    μ̇ = ad*_ξ μ + f

The Hamilton–Poincaré equations are the same in (x, p, μ), with ẋ = M⁻¹ p.  The Euler–Poincaré
equations are only the last line, at a fixed shape.  τ are joint torques, and f is a wrench on the
base in its frame.  −⟨f, A_α⟩ is the work of f in a horizontal motion, ξ = −A ẋ.  Gravity along the
group's translations does not appear: the equations hold in the falling frame.

With balls, ẋ is the rate σ along the frame of the shape, and ∂_α is the derivative along it.  The
frame's structure constants c add the term −c^γ_αβ p_γ σ^β to the shape equation, which is p × σ for
a ball, and −c^γ_αβ A_γ to the curvature.

If gravity rotates a pivoted base (SO(3), with the pivot away from the centre of mass c), its
direction in the body Γ = Rᵀ ĝ is a variable too, Γ̇ = Γ × ξ.  With the gravity force F = m |g| Γ,

    f_weight = c × F  in μ̇,     F·∂_αc − ⟨c × F, A_α⟩  in the shape equation,

and −F·c is added to the energy h.  Then `gamma`, or the pose that determines it, is required.

Source: Cendra, Marsden, Ratiu 2001, ch. 3; Cendra, Marsden, Pekarsky, Ratiu,
"Variational principles for Lie–Poisson and Hamilton–Poincaré equations", 2003; for the weight:
Holm, Marsden, Ratiu, "The Euler–Poincaré equations and semidirect products", 1998.

Symmetry and variations of the reduced action: the variation δg = g η of a motion changes its body
twist by δξ = η̇ + [ξ, η].  With the vertical part ζ = η + A δx of the variation, the locked
velocity Ω = ξ + A ẋ changes by

    δΩ = ζ̇ + [ξ, ζ] − [Ω, A δx] − ⟨B, (ẋ, δx)⟩,   ⟨B, (ẋ, δx)⟩ = B_αβ ẋ^α δx^β.

With balls, ẋ and δx are rates and displacements along the frame of the shape, and B contains the
frame's term, so the formula is the same.

The Euler–Poincaré and Lagrange–Poincaré equations follow from these constrained variations.  For
any left-invariant Lagrangian ℓ(ξ), they are d/dt ∂ℓ/∂ξ = ad*_ξ ∂ℓ/∂ξ.

Source: Cendra, Marsden, Ratiu, "Lagrangian reduction by stages", 2001, ch. 3.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..common.argument_kinds import call_function, checks_arguments
from ..common.arrays import Array, FrozenArrays, read_only, vector
from ..common.errors import InputError
from ..lie.group import Group
from ..lie.rotations import apply, rotation
from ..system.coordinates import Velocity
from .base_parts import root_of
from .pointwise_reduction import PointwiseReduction, ReducedShape
from .potential import pivot_weight

_UNIT = 1e-6  # largest deviation of |gamma| from 1


class _Terms:
    """Base of dataclasses whose fields are the terms of one equation."""

    @property
    def total(self) -> Array:
        """Sum of all terms."""
        return np.asarray(np.sum([values for _, values in self._named()], axis=0))

    def __str__(self) -> str:
        rows = [*self._named(), ("total", self.total)]
        return "\n".join(f"  {name:<12} {_row(values)}" for name, values in rows)

    def _named(self) -> list[tuple[str, Array]]:
        return list(vars(self).items())


@dataclass(frozen=True)
class ShapeForces(_Terms):
    """The terms of d/dt(M ẋ) = ṗ, each (m,) [N m | N].

    Attributes:
        metric: Force ½ ẋᵀ ∂M ẋ of the changing metric.
        centrifugal: Centrifugal force ½ Ωᵀ ∂I Ω.
        potential: Potential force −∂V.
        curvature: Magnetic-like force ⟨μ, B_αβ⟩ ẋ^β of the curvature.
        coadjoint: Coupling force −⟨μ, [Ω, A_α]⟩.
        torque: Joint torque τ.
        wrench: Effect −⟨f, A_α⟩ of the wrench f on the base.
        weight: Effect F·∂_αc − ⟨c × F, A_α⟩ of the weight of a pivoted base.
        frame: Effect −c^γ_αβ p_γ ẋ^β of the frame's rotation, p × ẋ for a ball; zero without balls.
    """

    metric: Array
    centrifugal: Array
    potential: Array
    curvature: Array
    coadjoint: Array
    torque: Array
    wrench: Array
    weight: Array
    frame: Array


@dataclass(frozen=True)
class MomentumForces(_Terms):
    """The terms of μ̇, each (r,) [N; N m].

    Attributes:
        coadjoint: Rotation with the body, ad*_ξ μ.
        wrench: Wrench f on the base.
        weight: Moment c × F of the weight.
    """

    coadjoint: Array
    wrench: Array
    weight: Array


@dataclass(frozen=True)
class LagrangePoincare:
    """The Lagrange–Poincaré equations at one state.

    Attributes:
        shape: Terms of d/dt(M ẋ).
        momentum: Terms of μ̇.
        xddot: Shape acceleration, (m,) [rad/s² | m/s²].
        xidot: Rate of the body twist, (r,) [m/s²; rad/s²].
    """

    shape: ShapeForces
    momentum: MomentumForces
    xddot: Array
    xidot: Array

    def __str__(self) -> str:
        return (
            f"d/dt(M xdot)\n{self.shape}\nd/dt mu\n{self.momentum}\n"
            f"xddot  {_row(self.xddot)}\nxidot  {_row(self.xidot)}"
        )


@dataclass(frozen=True)
class HamiltonPoincare:
    """The Hamilton–Poincaré equations at one state.

    Attributes:
        xdot: Shape rate M⁻¹ p, (m,) [rad/s | m/s].
        shape: Terms of ṗ.
        momentum: Terms of μ̇.
        energy: Energy h = ½ pᵀ M⁻¹ p + V + ½ μᵀ I⁻¹ μ [J], with −F·c if gravity rotates a pivoted
            base.
    """

    xdot: Array
    shape: ShapeForces
    momentum: MomentumForces
    energy: float

    def __str__(self) -> str:
        return (
            f"d/dt x  {_row(self.xdot)}\nd/dt p\n{self.shape}\nd/dt mu\n{self.momentum}\n"
            f"energy  {self.energy:+.9e}"
        )


@dataclass(frozen=True)
class EulerPoincare:
    """The Euler–Poincaré equations of the system with locked joints.

    Attributes:
        momentum: Terms of μ̇ = ad*_ξ μ + f.
        xidot: Rate of the body twist, I⁻¹ μ̇, (r,) [m/s²; rad/s²].
    """

    momentum: MomentumForces
    xidot: Array

    def __str__(self) -> str:
        return f"d/dt mu\n{self.momentum}\nxidot  {_row(self.xidot)}"


@checks_arguments
def lagrange_poincare(
    red: PointwiseReduction,
    x: ArrayLike,
    xdot: ArrayLike,
    omega: ArrayLike,
    *,
    torque: ArrayLike | None = None,
    wrench: ArrayLike | None = None,
    gamma: ArrayLike | None = None,
    pose: ArrayLike | None = None,
) -> LagrangePoincare:
    """Evaluate the Lagrange–Poincaré equations.

    Args:
        red: Reduction of the system.
        x: Shape, (nx,) [rad | m | 1].
        xdot: Shape rate, (m,) [rad/s | m/s].
        omega: Locked velocity Ω = ξ + A ẋ (`red.locked_velocity`), (r,).
        torque: Joint torques, (m,) [N m | N].
        wrench: Wrench on the base in its frame, (r,) [N; N m].
        gamma: Direction of gravity in the body, (3,).  `gamma` or `pose` is required if and only
            if gravity rotates a pivoted base.
        pose: Pose coordinates of the base.
    Returns:
        The terms and the accelerations.  Raises SymmetryError if gravity breaks the symmetry.
    """
    at, F = red.at(x), _weight(red, gamma, pose)
    xdot = vector(xdot, red.system.m, "xdot")
    omega = vector(omega, red.system.r, "omega")
    mu = at.locked_inertia @ omega
    momentum = _momentum_forces(red, omega - at.local_connection @ xdot, mu, wrench, F, at.com)
    shape = _shape_forces(red, at, xdot, omega, torque, momentum, F)
    # Solve for the accelerations: d/dt(M ẋ) = M ẍ + Ṁ ẋ,  μ̇ = I Ω̇ + İ Ω,  ξ̇ = Ω̇ − A ẍ − Ȧ ẋ
    xddot = _solve(at.reduced_metric, shape.total - at.dM @ xdot @ xdot)
    omegadot = _solve(at.locked_inertia, momentum.total - at.dI @ xdot @ omega)
    xidot = np.asarray(omegadot - at.local_connection @ xddot - at.dA @ xdot @ xdot)
    return LagrangePoincare(shape, momentum, read_only(xddot), read_only(xidot))


@checks_arguments
def hamilton_poincare(
    red: PointwiseReduction,
    x: ArrayLike,
    p: ArrayLike,
    mu: ArrayLike,
    *,
    torque: ArrayLike | None = None,
    wrench: ArrayLike | None = None,
    gamma: ArrayLike | None = None,
    pose: ArrayLike | None = None,
) -> HamiltonPoincare:
    """Evaluate the Hamilton–Poincaré equations.

    Args:
        red: Reduction of the system.
        x: Shape, (nx,) [rad | m | 1].
        p: Horizontal shape momentum M ẋ, (m,) [N m s | N s].
        mu: Body momentum, (r,) [N s; N m s].
        torque: Joint torques, (m,) [N m | N].
        wrench: Wrench on the base in its frame, (r,) [N; N m].
        gamma: Direction of gravity in the body, (3,).  `gamma` or `pose` is required if and only
            if gravity rotates a pivoted base.
        pose: Pose coordinates of the base.
    Returns:
        The terms and the energy.  Raises SymmetryError if gravity breaks the symmetry.
    """
    at, F = red.at(x), _weight(red, gamma, pose)
    p, mu = vector(p, red.system.m, "p"), vector(mu, red.system.r, "mu")
    xdot = _solve(at.reduced_metric, p)
    omega = _solve(at.locked_inertia, mu)
    momentum = _momentum_forces(red, omega - at.local_connection @ xdot, mu, wrench, F, at.com)
    kinetic, potential = 0.5 * float(p @ xdot + mu @ omega), red.shape_potential().value(at.x)
    return HamiltonPoincare(
        xdot=read_only(xdot),
        shape=_shape_forces(red, at, xdot, omega, torque, momentum, F),
        momentum=momentum,
        energy=kinetic + potential + _weight_energy(red, F, at.com),
    )


@checks_arguments
def euler_poincare(
    red: PointwiseReduction,
    x: ArrayLike,
    xi: ArrayLike,
    *,
    wrench: ArrayLike | None = None,
    gamma: ArrayLike | None = None,
    pose: ArrayLike | None = None,
) -> EulerPoincare:
    """Evaluate the Euler–Poincaré equations of the system with locked joints.

    Args:
        red: Reduction of the system.
        x: Shape, (nx,) [rad | m | 1].
        xi: Body twist, (r,) [m/s; rad/s].
        wrench: Wrench on the base in its frame, (r,) [N; N m].
        gamma: Direction of gravity in the body, (3,).  `gamma` or `pose` is required if and only
            if gravity rotates a pivoted base.
        pose: Pose coordinates of the base.
    Returns:
        The terms and the rate of the twist.  Raises SymmetryError if gravity breaks the symmetry.
    """
    F = _weight(red, gamma, pose)
    red.shape_potential()  # raises SymmetryError if gravity breaks the symmetry
    at, xi = red.split(x), vector(xi, red.system.r, "xi")
    momentum = _momentum_forces(red, xi, at.locked_inertia @ xi, wrench, F, at.com)
    return EulerPoincare(momentum, read_only(_solve(at.locked_inertia, momentum.total)))


def _weight(
    red: PointwiseReduction, gamma: ArrayLike | None, pose: ArrayLike | None
) -> Array | None:
    """Return the gravity force F = m |g| Γ in the body's frame, (3,), if it rotates the base."""
    fixed, name = pivot_weight(red.system), red.system.name
    if not fixed.any():
        if gamma is not None or pose is not None:
            raise InputError(
                f"gravity rotates no pivoted base of '{name}'; leave gamma and pose out"
            )
        return None
    if (gamma is None) == (pose is None):
        raise InputError(
            f"gravity rotates '{name}' about its pivot: pass either gamma (3,), the direction of "
            "gravity in the body's frame, or pose"
        )
    if gamma is None:
        R = rotation(red.group.pose(pose))
        return np.asarray(apply(R.T, fixed))
    direction = vector(gamma, 3, "gamma")
    length = float(np.linalg.norm(direction))
    if not abs(length - 1.0) <= _UNIT:
        raise InputError(f"gamma must be a direction of length 1, got length {length:g}")
    return np.asarray(float(np.linalg.norm(fixed)) * direction)


def _weight_energy(red: PointwiseReduction, F: Array | None, com: Array) -> float:
    """Return the potential energy of gravity, zero at the height of the world's origin [J]."""
    if F is None:
        return 0.0
    return -float(F @ com + pivot_weight(red.system) @ root_of(red.system).origin)


def _shape_forces(
    red: PointwiseReduction,
    at: ReducedShape,
    xdot: Array,
    omega: Array,
    torque: ArrayLike | None,
    momentum: MomentumForces,
    F: Array | None,
) -> ShapeForces:
    mu, weight = at.locked_inertia @ omega, np.zeros(red.system.m)
    if F is not None:
        weight = F @ red.com_slope(at.x) - momentum.weight @ at.local_connection
    return ShapeForces(
        metric=read_only(0.5 * np.einsum("abc,a,b->c", at.dM, xdot, xdot)),
        centrifugal=read_only(0.5 * np.einsum("abc,a,b->c", at.dI, omega, omega)),
        potential=read_only(0.0 - red.shape_potential().gradient(at.x)),
        curvature=read_only(np.einsum("iab,i,b->a", at.curvature, mu, xdot)),
        coadjoint=read_only(-red.group.ad(omega).T @ mu @ at.local_connection),
        torque=_vector_or_zero(torque, red.system.m, "torque"),
        wrench=read_only(-momentum.wrench @ at.local_connection),
        weight=read_only(weight),
        frame=read_only(_frame_force(red, at, xdot)),
    )


def _frame_force(red: PointwiseReduction, at: ReducedShape, xdot: Array) -> Array:
    """Return −c^γ_αβ p_γ ẋ^β, (m,), with p = M ẋ."""
    space = red.system.space
    if not space.balls:
        return np.zeros(space.m)
    return np.asarray(-np.einsum("gab,g,b->a", space.structure, at.reduced_metric @ xdot, xdot))


def _momentum_forces(
    red: PointwiseReduction,
    xi: Array,
    mu: Array,
    wrench: ArrayLike | None,
    F: Array | None,
    com: Array,
) -> MomentumForces:
    coadjoint = read_only(red.group.coadjoint(xi, mu))
    moment = np.zeros(red.system.r) if F is None else np.cross(com, F)
    force = _vector_or_zero(wrench, red.system.r, "wrench")
    return MomentumForces(coadjoint, force, read_only(moment))


def _solve(matrix: Array, rhs: Array) -> Array:
    return np.asarray(np.linalg.solve(matrix, rhs), dtype=float)


def _vector_or_zero(value: ArrayLike | None, size: int, name: str) -> Array:
    return read_only(np.zeros(size) if value is None else vector(value, size, name).copy())


def _row(values: Array) -> str:
    return " ".join(f"{value:+.9e}" for value in values)


@checks_arguments
def infinitesimal_generator(red: PointwiseReduction, pose: ArrayLike, zeta: ArrayLike) -> Velocity:
    """Compute the infinitesimal generator ζ_Q(q) = d/ds exp(sζ)·q at s = 0.

    The symmetry moves the whole robot in space.  In the body frame, the twist is Ad_{g⁻¹} ζ.

    Args:
        red: Reduction of the system.
        pose: Pose coordinates of the base.
        zeta: Twist in space, (r,) [m/s; rad/s].
    Returns:
        The velocity of the generator at the configuration; no joint moves.
    """
    group, system = red.group, red.system
    to_body = group.Ad(group.inverse(group.pose(pose)))
    return Velocity(to_body @ vector(zeta, system.r, "zeta"), np.zeros(system.m))


@dataclass(frozen=True)
class ConstrainedVariation(FrozenArrays):
    """Variations of the velocities that a variation of a motion causes.

    Attributes:
        twist: Variation δξ of the body twist, (r,).
        locked: Variation δΩ of the locked velocity, (r,).
    """

    twist: Array
    locked: Array


@checks_arguments
def constrained_variation(
    red: PointwiseReduction,
    x: ArrayLike,
    xdot: ArrayLike,
    xi: ArrayLike,
    *,
    eta: ArrayLike,
    etadot: ArrayLike,
    dx: ArrayLike,
    dxdot: ArrayLike,
) -> ConstrainedVariation:
    """Compute the variations of twist and locked velocity for a variation (g η, δx) of a motion.

    Args:
        red: Reduction of the system.
        x: Shape, (nx,) [rad | m | 1].
        xdot: Shape rate, (m,) [rad/s | m/s].
        xi: Body twist, (r,) [m/s; rad/s].
        eta: Variation η = g⁻¹ δg of the pose, (r,) [m; rad].
        etadot: Rate of η, (r,) [m/s; rad/s].
        dx: Variation δx of the shape, (m,) [rad | m].
        dxdot: Rate of δx, (m,) [rad/s | m/s].
    Returns:
        δξ and δΩ.
    """
    system, bracket, at = red.system, red.group.bracket, red.at(x)
    v, variation, rate = (
        vector(value, system.m, name)
        for value, name in ((xdot, "xdot"), (dx, "dx"), (dxdot, "dxdot"))
    )
    twist, displacement, moved_rate = (
        vector(value, system.r, name)
        for value, name in ((xi, "xi"), (eta, "eta"), (etadot, "etadot"))
    )
    A = at.local_connection
    omega, vertical = twist + A @ v, displacement + A @ variation
    vertical_rate = moved_rate + A @ rate + at.dA @ v @ variation
    locked = vertical_rate + bracket(twist, vertical) - bracket(omega, A @ variation)
    locked = locked - np.einsum("iab,a,b->i", at.curvature, v, variation)
    return ConstrainedVariation(moved_rate + bracket(twist, displacement), locked)


@dataclass(frozen=True)
class InvariantMotion(FrozenArrays):
    """The Euler–Poincaré equations of a left-invariant Lagrangian ℓ(ξ).

    Attributes:
        momentum: Momentum ∂ℓ/∂ξ, (r,).
        momentum_rate: Its rate ad*_ξ ∂ℓ/∂ξ, (r,).
        xidot: Rate of the body twist, (r,).
        energy: Energy ⟨∂ℓ/∂ξ, ξ⟩ − ℓ.
    """

    momentum: Array
    momentum_rate: Array
    xidot: Array
    energy: float


@checks_arguments
def euler_poincare_of_lagrangian(
    group: Group, lagrangian: Callable[[Any], Any], xi: ArrayLike
) -> InvariantMotion:
    """Evaluate the Euler–Poincaré equations of any left-invariant Lagrangian ℓ(ξ) on a group.

    Args:
        group: Symmetry group.
        lagrangian: Function from a CasADi column ξ, (r,), to the scalar ℓ.
        xi: Body twist, (r,) [m/s; rad/s].
    Returns:
        Momentum, its rate, the rate of the twist, and the energy.
    Raises:
        InputError: ℓ is not a scalar expression in ξ, or ∂²ℓ/∂ξ² is singular at ξ.
    """
    import casadi as ca

    symbols, twist = ca.SX.sym("xi", group.dim), vector(xi, group.dim, "xi", group.twist_names)
    value = call_function(lagrangian, "lagrangian", symbols)
    if not isinstance(value, ca.SX) or value.shape != (1, 1):
        raise InputError(
            f"lagrangian: expected a scalar CasADi expression in xi, got {type(value).__name__}"
        )
    hessian, gradient = ca.hessian(value, symbols)
    derivatives = ca.Function("l", [symbols], [value, gradient, hessian])(twist)
    energy, momentum, metric = (np.array(entry, dtype=float) for entry in derivatives)
    mu = momentum.ravel()
    rate = group.coadjoint(twist, mu)
    condition = np.linalg.cond(metric) if np.isfinite(metric).all() else np.inf
    if not condition < 1.0 / np.finfo(float).eps:
        raise InputError(f"lagrangian: expected a regular second derivative, got\n{metric}")
    xidot = np.linalg.solve(metric, rate)
    return InvariantMotion(mu, rate, xidot, float(mu @ twist - energy.item()))
