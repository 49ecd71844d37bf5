"""Fields of the reduction over many shapes, evaluated by compiled code."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, FrozenArrays, read_only, vector
from ...common.errors import SymmetryError
from ...integrators.stepping.compiling import compiled
from ...kernels.connection.connection_code import Locals
from ...reduction.pointwise_reduction import Moves, cholesky, usual_inertias
from ...reduction.potential import Potential
from ...system.system import System
from .drag_fluid_and_wheels import centres_of_mass, mechanical_code

# Pivots of the mass matrix below this multiple of n ε times the diagonal entry (ε: machine
# precision) need the accurate test for singularity.
_SUSPICIOUS = 16.0


@checks_arguments
@dataclass(frozen=True, eq=False)
class ShapeField(FrozenArrays):
    """The reduction at many shapes, with the leading axes of x first in every array.

    Each array is computed at first use, cached, and read-only.  The attributes are named as in
    `ReducedShape`.  Every array that needs the inertia raises SingularInertiaError, naming the
    shape, if the mass matrix is numerically singular at one of the shapes.

    Attributes:
        system: The system.
        x: Shapes, (..., nx) [rad | m].
    """

    system: System = field(repr=False)
    x: Array
    _potential: Potential | SymmetryError = field(repr=False)
    _moves: tuple[Moves, ...] = field(repr=False, default=())

    @cached_property
    def mass_matrix(self) -> Array:
        """Mass matrix H, (..., n, n), base rows first."""
        H = self._locals.matrix
        for move in self._moves:
            H = move.mass_matrix(H)
        return self._as_field(H)

    @property
    def locked_inertia(self) -> Array:
        """Locked inertia I = H_bb, (..., r, r)."""
        r = self.system.r
        return self.mass_matrix[..., :r, :r]

    @cached_property
    def local_connection(self) -> Array:
        """Local connection A = I⁻¹ H_bs, (..., r, m)."""
        A = self._locals.A
        for move in self._moves:
            A = move.local_connection(A)
        return self._as_field(A)

    @cached_property
    def reduced_metric(self) -> Array:
        """Reduced metric M = H_ss − Aᵀ I A, (..., m, m)."""
        M = self._locals.M
        assert M is not None, "the mechanical connection has a metric"
        return self._as_field(M)

    @cached_property
    def curvature(self) -> Array:
        """Curvature B_αβ = ∂_αA_β − ∂_βA_α − [A_α, A_β] − c^γ_αβ A_γ, (..., r, m, m)."""
        _ = self._locals  # raises SingularInertiaError
        B, _ = mechanical_code(self.system).curvature(self._shapes)
        for move in self._moves:
            B = move.curvature(B)
        return self._as_field(B)

    @cached_property
    def com(self) -> Array:
        """Centre of mass in the root body's frame, (..., 3) [m]."""
        com = self._com
        for move in self._moves:
            com = move.com(com)
        return self._as_field(com)

    @cached_property
    def potential(self) -> Array:
        """Potential V, (...,) [J].  Raises SymmetryError if gravity breaks the symmetry."""
        if isinstance(self._potential, SymmetryError):
            raise self._potential
        return self._as_field(self._potential.values(self._shapes, self._com))

    def amended_potential(self, mu: ArrayLike) -> Array:
        """Compute V + ½ μᵀ I⁻¹ μ for one body momentum at every shape.

        Args:
            mu: Body momentum, (r,) [N s | N m s].
        Returns:
            (...,) [J].
        Raises:
            SymmetryError: Gravity breaks the symmetry.
            ShapeError: mu has the wrong length or is not finite.
        """
        mu = vector(mu, self.system.r, "mu")
        potential = self.potential
        omega = np.linalg.solve(self.locked_inertia, mu[:, None])[..., 0]
        return read_only(np.asarray(potential + 0.5 * omega @ mu))

    @cached_property
    def _locals(self) -> Locals:
        """H, A and M with respect to the base frame of the robot file."""
        terms = mechanical_code(self.system).locals(self._shapes)
        _refuse_singular(self.system, self._shapes, terms.matrix)
        return terms

    @cached_property
    def _com(self) -> Array:
        """The centre of mass in the base frame of the robot file, (N, 3) [m]."""
        return centres_of_mass(self.system, self._shapes)

    @property
    def _shapes(self) -> Array:
        """The shapes as rows, (N, nx)."""
        return self.x.reshape(math.prod(self.x.shape[:-1]), self.system.nx)

    def _as_field(self, array: Array) -> Array:
        return read_only(array.reshape((*self.x.shape[:-1], *array.shape[1:])))


def _refuse_singular(system: System, x: Array, H: Array) -> None:
    """Raise SingularInertiaError, naming the first shape of x (N, nx) with a singular H."""
    least = usual_inertias(system) if system.doubts else np.zeros(system.n)
    suspicious = np.zeros(len(H), dtype=np.bool_)
    _find_small_pivots(H, least, np.empty((system.n, system.n)), suspicious)
    for k in np.flatnonzero(suspicious):
        cholesky(H[k], system, x[k])


@compiled
def _find_small_pivots(H: Array, least: Array, L: Array, suspicious: NDArray[np.bool_]) -> None:
    """Flag the matrices H (N, n, n) with a small pivot; least: smallest scales, (n,)."""
    n = len(least)
    limit = _SUSPICIOUS * n * np.finfo(np.float64).eps
    for k in range(len(H)):
        for i in range(n):
            for j in range(i + 1):
                L[i, j] = H[k, i, j]
        for j in range(n):
            pivot = L[j, j]
            if not pivot > limit * max(H[k, j, j], least[j]):
                suspicious[k] = True
                break
            for i in range(j + 1, n):
                factor = L[i, j] / pivot
                for l in range(j + 1, i + 1):
                    L[i, l] -= factor * L[l, j]
