"""ConnectionField: the quantities of a connection at many shapes."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, read_only
from ...kernels.connection.connection_code import ConnectionCode, Curvatures
from ...kernels.connection.connection_form import ConnectionForm
from .singular_shapes import refuse_singular, require_metric


class EvaluatedConnection(Protocol):
    """The members of Connection that its fields use; Connection imports this module."""

    @property
    def form(self) -> ConnectionForm: ...  # noqa: D102

    @property
    def code(self) -> ConnectionCode: ...  # noqa: D102

    @property
    def nx(self) -> int: ...  # noqa: D102

    def locals_at(self, x: Array) -> tuple[Array, Array | None, Array]: ...  # noqa: D102

    def curvatures_at(self, x: Array) -> Curvatures: ...  # noqa: D102


@checks_arguments
@dataclass(frozen=True, eq=False)
class ConnectionField:
    """A connection at many shapes, with the leading axes of x first in every array.

    Each array is computed at first use, cached, and read-only.  It raises SingularInertiaError
    if A is not defined at one of the shapes.

    Attributes:
        connection: The connection.
        x: Shapes, (..., nx) [rad | m].
    """

    connection: EvaluatedConnection = field(repr=False)
    x: Array

    @property
    def local(self) -> Array:
        """Local connection A, (..., r, m)."""
        return self._locals[0]

    @property
    def metric(self) -> Array:
        """Metric M, (..., m, m).  Raises InputError if the connection has no metric."""
        return require_metric(self.connection.form, self._locals[1])

    @cached_property
    def curvature(self) -> Array:
        """Curvature B_αβ = ∂_αA_β − ∂_βA_α − [A_α, A_β] − c^γ_αβ A_γ, (..., r, m, m)."""
        B, health = self.connection.code.curvature(self._flat)
        refuse_singular(self.connection.form, self._flat, health)
        return self._shaped(B)

    @property
    def exterior(self) -> Array:
        """Exterior derivative ∂_αA_β − ∂_βA_α − c^γ_αβ A_γ: B of a commutative group."""
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
        return self.x.reshape(-1, self.connection.nx)

    def _shaped(self, array: Array) -> Array:
        return read_only(array.reshape(*self.x.shape[:-1], *array.shape[1:]))
