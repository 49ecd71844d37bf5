"""The mass matrix at one shape, split along the symmetry.

H(x) = [[I, IA], [AᵀI, M̃]],   A = I⁻¹ H_bs,   M = H_ss − Aᵀ I A.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ..common.arrays import Array, freeze, vector
from ..common.errors import SingularInertiaError
from ..system.system import System

_SAMPLES = 20  # random shapes that tell what is usual


@dataclass(frozen=True)
class InertiaSplit:
    """Inertia at one shape x; arrays are read-only.

    mass_matrix: (n, n), base rows first.  locked_inertia: (r, r).  local_connection:
    (r, m).  reduced_metric: (m, m).  com: (3,) centre of mass in the root body's frame [m].
    """

    x: Array
    mass_matrix: Array
    locked_inertia: Array
    local_connection: Array
    reduced_metric: Array
    com: Array

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def r(self) -> int:
        """Dimension of the group."""
        return len(self.locked_inertia)

    def kinetic_energy(self, xdot: ArrayLike, xi: ArrayLike) -> float:
        """½ vᵀ H v with v = (ξ, ẋ) [J]."""
        v = self._velocity(xdot, xi)
        return 0.5 * float(v @ self.mass_matrix @ v)

    def body_momentum(self, xdot: ArrayLike, xi: ArrayLike) -> Array:
        """μ = I ξ + I A ẋ, (r,), in the frame of the root body."""
        return np.asarray(self.mass_matrix[: self.r] @ self._velocity(xdot, xi))

    def locked_velocity(self, xdot: ArrayLike, xi: ArrayLike) -> Array:
        """Ω = ξ + A ẋ, (r,): the twist of the system if its joints froze; μ = I Ω."""
        v = self._velocity(xdot, xi)
        return np.asarray(v[: self.r] + self.local_connection @ v[self.r :])

    def locked_energy(self, mu: ArrayLike) -> float:
        """½ μᵀ I⁻¹ μ [J], the energy of body momentum mu (r,) with frozen joints."""
        mu = vector(mu, self.r, "mu")
        return 0.5 * float(mu @ np.linalg.solve(self.locked_inertia, mu))

    def _velocity(self, xdot: ArrayLike, xi: ArrayLike) -> Array:
        m = len(self.reduced_metric)
        return np.concatenate([vector(xi, self.r, "xi"), vector(xdot, m, "xdot")])


def split_inertia(system: System, x: Array, H: Array, com: Array) -> InertiaSplit:
    """Split the mass matrix H (n, n) of `system` at shape x.

    Raises SingularInertiaError, naming the direction without inertia, if H is not
    positive definite to working precision.
    """
    r, L = system.r, cholesky(H, system, x)
    return InertiaSplit(
        x=x,
        mass_matrix=H,
        locked_inertia=H[:r, :r].copy(),
        # H = L Lᵀ by blocks: I = L₁₁L₁₁ᵀ, A = L₁₁⁻ᵀ L₂₁ᵀ, and M = L₂₂L₂₂ᵀ loses no digits.
        # (SciPy's triangular solver starts threads even for these few numbers.)
        local_connection=np.asarray(np.linalg.solve(L[:r, :r].T, L[r:, :r].T)),
        reduced_metric=L[r:, r:] @ L[r:, r:].T,
        com=com,
    )


def cholesky(H: Array, system: System, x: Array) -> Array:
    """Return L with H = L Lᵀ.  Raises SingularInertiaError as `split_inertia` does."""
    try:
        L = np.asarray(np.linalg.cholesky(H), dtype=float)
    except np.linalg.LinAlgError:
        eigenvalues, directions = np.linalg.eigh(H)
        i = int(np.argmax(np.abs(directions[:, 0])))
        found = f"least eigenvalue {eigenvalues[0]:.3g}"
    else:
        own = own_part(L, H, system)
        if (own > len(H) * np.finfo(float).eps).all():
            return np.asarray(L)
        i = int(np.argmin(own))
        found = f"{own[i]:.1e} of its inertia is its own"
    if i < system.r:
        who = f"direction {i} of the root joint '{system.root_name}'"
    else:
        who = f"joint '{system.shape_names[i - system.r]}'"
    raise SingularInertiaError(
        f"the mass matrix of '{system.name}' is singular to working precision at x = {x}: "
        f"{who} has no inertia of its own ({found})"
    )


def own_part(L: Array, H: Array, system: System) -> Array:
    """Return the part of each diagonal entry that the coordinates before it do not explain.

    L: (..., n, n), with H = L Lᵀ.  Where a mass matrix can be singular, entries count at least
    with what they usually are.
    """
    size = np.diagonal(H, axis1=-2, axis2=-1)
    if system.doubts:
        size = np.maximum(size, usual_inertias(system))
    return np.asarray(np.diagonal(L, axis1=-2, axis2=-1) ** 2 / size)


def usual_inertias(system: System) -> Array:
    """Return the diagonal of the mass matrix, (n,), each entry at its largest over some shapes."""
    return np.asarray(np.max([np.diag(H) for H in usual_mass_matrices(system)], axis=0))


def usual_mass_matrices(system: System) -> list[Array]:
    """Return the mass matrices (n, n) at some random shapes, found once."""
    rng = np.random.default_rng(0)
    shapes = rng.uniform(-np.pi, np.pi, (_SAMPLES, system.m))
    return system.workspace(usual_mass_matrices, lambda: [mass_matrix(system, x) for x in shapes])


def mass_matrix(system: System, x: Array) -> Array:
    """Return the mass matrix (n, n) at shape x (m,), whatever it is."""
    data = system.workspace(mass_matrix, system.model.createData)
    return mass_matrix_at(system, system.model, data, system.group.identity(), x)


def mass_matrix_at(
    system: System, model: pin.Model, data: pin.Data, pose: Array, x: Array
) -> Array:
    """Return the mass matrix (n, n) of base and shape by CRBA, with what that leaves in `data`.

    model: the system's, or one that differs from it in gravity.
    """
    upper = pin.crba(model, data, system.model_q(pose, x))
    return system.coupled_matrix(symmetric(upper))


def symmetric(upper: Array) -> Array:
    """Return the matrix whose upper triangle CRBA filled."""
    return np.asarray(np.triu(upper) + np.triu(upper, 1).T)
