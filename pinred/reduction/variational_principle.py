"""Symmetry and variations of the reduced action.

The variation δg = g η of a motion changes its body twist by δξ = η̇ + [ξ, η].  With the vertical
part ζ = η + A δx of the variation, the locked velocity Ω = ξ + A ẋ changes by

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
from ..common.arrays import Array, FrozenArrays, vector
from ..common.errors import InputError
from ..lie.group import Group
from ..system.coordinates import Velocity
from .pointwise_reduction import PointwiseReduction


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
    twist, moved, moved_rate = (
        vector(value, system.r, name)
        for value, name in ((xi, "xi"), (eta, "eta"), (etadot, "etadot"))
    )
    A = at.local_connection
    omega, vertical = twist + A @ v, moved + A @ variation
    vertical_rate = moved_rate + A @ rate + at.dA @ v @ variation
    locked = vertical_rate + bracket(twist, vertical) - bracket(omega, A @ variation)
    locked = locked - np.einsum("iab,a,b->i", at.curvature, v, variation)
    return ConstrainedVariation(moved_rate + bracket(twist, moved), locked)


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
    found = ca.Function("l", [symbols], [value, gradient, hessian])(twist)
    energy, momentum, metric = (np.array(entry, dtype=float) for entry in found)
    mu = momentum.ravel()
    rate = group.coadjoint(twist, mu)
    condition = np.linalg.cond(metric) if np.isfinite(metric).all() else np.inf
    if not condition < 1.0 / np.finfo(float).eps:
        raise InputError(f"lagrangian: expected a regular second derivative, got\n{metric}")
    xidot = np.linalg.solve(metric, rate)
    return InvariantMotion(mu, rate, xidot, float(mu @ twist - energy.item()))
