"""A connection as a field over many shapes."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

from ...common.arrays import Array, read_only

if TYPE_CHECKING:
    from .connection import Connection


@dataclass(frozen=True, eq=False)
class ConnectionField:
    """A connection at many shapes, with the leading axes of x first in every array.

    Each array is computed at first use, cached, and read-only.  Every array raises
    SingularInertiaError, naming the first shape at which A is not defined.

    Attributes:
        connection: The connection.
        x: Shapes, (..., m) [rad | m].
    """

    connection: Connection = field(repr=False)
    x: Array

    @property
    def local(self) -> Array:
        """Local connection A, (..., r, m)."""
        return self._locals[0]

    @property
    def metric(self) -> Array:
        """Metric M, (..., m, m).  Raises InputError if the connection has no metric."""
        return self.connection.checked_metric(self._locals[1])

    @cached_property
    def curvature(self) -> Array:
        """Curvature B_αβ = ∂_αA_β − ∂_βA_α − [A_α, A_β], (..., r, m, m)."""
        B, health = self.connection.code.curvature(self._flat)
        self.connection.refuse_singular(self._flat, health)
        return self._shaped(B)

    @property
    def exterior(self) -> Array:
        """Exterior derivative ∂_αA_β − ∂_βA_α, (..., r, m, m): B of a commutative group."""
        return self._parts[0]

    @property
    def bracket(self) -> Array:
        """Bracket [A_α, A_β], (..., r, m, m); curvature = exterior − bracket."""
        return self._parts[1]

    @cached_property
    def _locals(self) -> tuple[Array, Array | None]:
        A, M, _ = self.connection.locals_at(self._flat)
        return self._shaped(A), None if M is None else self._shaped(M)

    @cached_property
    def _parts(self) -> tuple[Array, Array]:
        terms = self.connection.curvatures_at(self._flat)
        return self._shaped(terms.exterior), self._shaped(terms.bracket)

    @property
    def _flat(self) -> Array:
        return self.x.reshape(-1, self.connection.m)

    def _shaped(self, array: Array) -> Array:
        return read_only(array.reshape(*self.x.shape[:-1], *array.shape[1:]))
