"""The reduction as fields over many shapes, for plots, gaits and statistics.

The mass matrix and its derivatives come from composite bodies in closed form, all shapes at
once; `Reduction.at` takes the same numbers from Pinocchio, one shape at a time.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ..common.arrays import Array, freeze, read_only, vector
from ..common.errors import SymmetryError
from ..system.system import System
from .inertia_split import cholesky, own_part
from .potential import Potential
from .section import Moves
from .tree.composite_bodies import CompositeBodies

_SHAPES = 2048  # at once through the bodies: few enough that work space stays in the cache
_ENTRIES = 2**16  # of d(IA) at once, for the same reason


@dataclass(frozen=True, eq=False)
class ShapeField:
    """The reduction at shapes x: (..., m), the leading axes first in every array.

    Each array is computed when it is first looked at, kept, and read-only; the names are
    those of `ReducedShape`.  Everything that needs the inertia raises SingularInertiaError, naming
    the shape, if the mass matrix is numerically singular at any of them.
    """

    system: System = field(repr=False)
    x: Array
    _potential: Potential | SymmetryError = field(repr=False)
    _moves: tuple[Moves, ...] = field(repr=False, default=())

    def __post_init__(self) -> None:
        freeze(self)

    @cached_property
    def mass_matrix(self) -> Array:
        """H, (..., n, n), base rows first."""
        H = self._factored[0]
        for move in self._moves:
            H = move.mass_matrix(H)
        return self._field(H)

    @property
    def locked_inertia(self) -> Array:
        """I = H_bb, (..., r, r)."""
        r = self.system.r
        return self.mass_matrix[..., :r, :r]

    @cached_property
    def local_connection(self) -> Array:
        """A = I⁻¹ H_bs, (..., r, m)."""
        A = self._connection
        for move in self._moves:
            A = move.local_connection(A)
        return self._field(A)

    @cached_property
    def reduced_metric(self) -> Array:
        """M = H_ss − Aᵀ I A, (..., m, m)."""
        r = self.system.r
        L = self._factored[1][:, r:, r:]
        return self._field(np.asarray(L @ np.swapaxes(L, 1, 2)))

    @cached_property
    def curvature(self) -> Array:
        """B_αβ = ∂_αA_β − ∂_βA_α − [A_α, A_β], (..., r, m, m), as `Reduction.curvature`."""
        r, m = self.system.r, self.system.m
        I, A = self._factored[0][:, :r, :r], self._connection
        B = np.zeros((len(self._shapes), r, m, m))
        for some in _slices(len(B) if m else 0, _SHAPES):
            dI = self._bodies.derivatives(self._shapes[some], B[some])  # d(IA) where B will be
            for few in _slices(len(dI), max(1, _ENTRIES // (r * m * m))):
                self._curve(I[some][few], A[some][few], dI[few], B[some][few])
        for move in self._moves:
            B = move.curvature(B)
        return self._field(B)

    @cached_property
    def com(self) -> Array:
        """Centre of mass in the root body's frame, (..., 3) [m]."""
        com = self._com
        for move in self._moves:
            com = move.com(com)
        return self._field(com)

    @cached_property
    def potential(self) -> Array:
        """V, (...,) [J].  Raises SymmetryError if gravity breaks the symmetry."""
        if isinstance(self._potential, SymmetryError):
            raise self._potential
        return self._field(self._potential.values(self._shapes, self._com))

    def amended_potential(self, mu: ArrayLike) -> Array:
        """V + ½ μᵀ I⁻¹ μ, (...,) [J], for one body momentum mu (r,), at every shape.

        Raises SymmetryError if gravity breaks the symmetry, ShapeError for a wrong mu.
        """
        mu = vector(mu, self.system.r, "mu")
        potential = self.potential
        omega = np.linalg.solve(self.locked_inertia, mu[:, None])[..., 0]
        return read_only(np.asarray(potential + 0.5 * omega @ mu))

    @cached_property
    def _factored(self) -> tuple[Array, Array]:
        """H and L with H = L Lᵀ, each (N, n, n)."""
        n, x = self.system.n, self._shapes
        H = np.zeros((len(x), n, n))
        for some in _slices(len(x), _SHAPES):
            self._bodies.mass_matrix(x[some], H[some])
        return read_only(H), _factors(H, self.system, x)

    @cached_property
    def _connection(self) -> Array:
        """A in the section of the robot's file, (N, r, m)."""
        r, L = self.system.r, self._factored[1]
        upper = np.swapaxes(L[:, :r, :r], 1, 2)
        return np.asarray(np.linalg.solve(upper, np.swapaxes(L[:, r:, :r], 1, 2)))

    @cached_property
    def _com(self) -> Array:
        """The centre of mass in the root body's own frame, (N, 3)."""
        com = np.empty((len(self._shapes), 3))
        for some in _slices(len(com), _SHAPES):
            com[some] = self._bodies.com(self._shapes[some])
        return com

    @cached_property
    def _bodies(self) -> CompositeBodies:
        return CompositeBodies(self.system)

    @property
    def _shapes(self) -> Array:
        """The shapes in one row, (N, m)."""
        return self._flat(self.x)

    def _flat(self, array: Array) -> Array:
        lead = self.x.ndim - 1
        return array.reshape(math.prod(array.shape[:lead]), *array.shape[lead:])

    def _field(self, array: Array) -> Array:
        return read_only(array.reshape(*self.x.shape[:-1], *array.shape[1:]))

    def _curve(self, I: Array, A: Array, dI: Array, out: Array) -> None:
        """Turn d(IA), (N, r, m, m), into the curvature, in place; dI: (N, m, r, r).

        I dA_αβ = ∂_α(IA)_β − ∂_αI A_β.  Half of the bracket, which is antisymmetric, is added to
        it, so that one product serves all and the antisymmetric part is taken at the end.
        """
        count, m, r, _ = dI.shape
        maps = dI + 0.5 * I[:, None] @ self.system.group.ad(np.swapaxes(A, 1, 2))
        product = maps.reshape(count, m * r, r) @ A
        out -= np.swapaxes(product.reshape(count, m, r, m), 1, 2)
        half = (np.linalg.inv(I) @ out.reshape(count, r, m * m)).reshape(out.shape)
        np.subtract(half, np.swapaxes(half, 2, 3), out=out)


def _factors(H: Array, system: System, x: Array) -> Array:
    """Return the Cholesky factors of all H.  Raises SingularInertiaError as one alone would."""
    try:
        L = np.asarray(np.linalg.cholesky(H), dtype=float)
    except np.linalg.LinAlgError:
        return np.stack([cholesky(h, system, shape) for h, shape in zip(H, x, strict=True)])
    enough = (own_part(L, H, system) > H.shape[1] * np.finfo(float).eps).all(axis=1)
    for k in np.flatnonzero(~enough):
        cholesky(H[k], system, x[k])
    return np.asarray(L)


def _slices(count: int, size: int) -> Iterator[slice]:
    """Yield the slices of `size` that make up `count`."""
    for start in range(0, count, size):
        yield slice(start, start + size)
