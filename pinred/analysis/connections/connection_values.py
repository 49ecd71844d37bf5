"""Values of a connection at one shape and at many shapes, as text, and as a notebook card.

Shapes at which a connection is not defined are rejected.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, read_only, vector, vectors
from ...common.errors import InputError, SingularInertiaError
from ...common.html import Rows, Summary
from ...kernels.connection.connection_code import ConnectionCode, Curvatures
from ...kernels.connection.connection_form import ConnectionForm
from ...lie.group import Group
from ...system.coordinates import ShapeSpace
from .rotation_chart import RotationChart

# Least health of P_b, by whether the form is symmetric.
_LEAST_HEALTH = {True: 16.0 * np.finfo(float).eps, False: 1e-9}


def refuse_singular(form: ConnectionForm, x: Array, health: Array) -> None:
    """Raise an error at shapes where A is not defined.

    Args:
        form: Form of the connection.
        x: Shapes, (N, nx) [rad | m].
        health: Health of P_b at these shapes, (N,).
    Raises:
        SingularInertiaError: P_b is singular; the message names the first shape.
    """
    size = health if form.symmetric else np.abs(health)
    singular = ~(size > _LEAST_HEALTH[form.symmetric])
    if singular.any():
        shape = x[int(np.argmax(singular))]
        raise SingularInertiaError(
            f"A is not defined at the shape {shape}: {form.what} do not determine the "
            "motion of the body there. Keep the joints away from this shape."
        )


def refuse_crossing(form: ConnectionForm, health: Array) -> None:
    """Reject paths across singular shapes, where a non-symmetric form's health changes sign.

    Args:
        form: Form of the connection.
        health: Health of P_b along the path, (N,).
    Raises:
        SingularInertiaError: P_b is singular between two shapes.
    """
    if not form.symmetric and health.min() < 0.0 < health.max():
        raise SingularInertiaError(
            f"the gait crosses shapes at which {form.what} do not determine the motion "
            "of the body. Choose a gait that stays on one side of these shapes."
        )


def require_metric(form: ConnectionForm, M: Array | None) -> Array:
    """Return the metric of a form.  Raises InputError if the form defines none."""
    if M is None:
        raise InputError(f"{form.what} define no metric on shape space")
    return M


_NAMES = 6  # largest number of joints that are named


class ConnectionSummary(Summary):
    """Base class of Connection that describes it by its form; nothing is compiled for this."""

    form: ConnectionForm
    turned_by_gravity: str
    chart: RotationChart | None

    def title(self) -> str:
        """Return the first line of the text."""
        return f"Connection({self.form.what}, {self.form.group.name}, m={self.form.m})"

    def rows(self) -> Rows:
        """Return the rows of the text: spaces, metric, and whether gravity changes momenta."""
        form = self.form
        names = [*form.joints[:_NAMES], *(["…"] if form.m > _NAMES else [])]
        joints = f": {', '.join(names)}" if names else ""
        rows = [
            ("group", f"{form.group.name}, r = {form.r}"),
            ("shape space", f"m = {form.m}{joints}"),
            ("metric", "on shape space" if form.symmetric else "none"),
        ]
        if self.turned_by_gravity:
            rows.append(("momenta", f"not conserved: {self.turned_by_gravity}"))
        if self.chart is not None:
            rows.append(("coordinates", self.chart.words))
        return rows


@checks_arguments
@dataclass(frozen=True, eq=False)
class ConnectionField:
    """A connection at many shapes, with the leading axes of x first in every array.

    Arrays are cached and read-only; SingularInertiaError is raised where A is not defined.

    Attributes:
        connection: The connection.
        x: Shapes, (..., nx) [rad | m].
    """

    connection: ConnectionValues = field(repr=False)
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


@checks_arguments
class ConnectionValues(ConnectionSummary):
    """Base class of Connection that evaluates its compiled code."""

    code: ConnectionCode

    @property
    def group(self) -> Group:
        """The symmetry group."""
        return self.form.group

    @property
    def joints(self) -> tuple[str, ...]:
        """Labels of the shape rates, which are the joint names for hinges and slides."""
        return self.form.joints

    @property
    def r(self) -> int:
        """Dimension of the group."""
        return self.form.r

    @property
    def m(self) -> int:
        """Dimension of shape space."""
        return self.form.m

    @property
    def nx(self) -> int:
        """Number of shape coordinates."""
        return self.form.nx

    @property
    def space(self) -> ShapeSpace:
        """Shape space, with its labels, frame and charts."""
        return self.form.space

    @property
    def has_metric(self) -> bool:
        """Whether there is a metric on shape space."""
        return self.form.symmetric

    def local(self, x: ArrayLike) -> Array:
        """Compute the local connection A(x).

        Args:
            x: Shape, (nx,) [rad | m].
        Returns:
            (r, m).  Raises SingularInertiaError if A is not defined there.
        """
        return read_only(self.locals_at(self._one(x))[0][0])

    def locked(self, x: ArrayLike) -> Array:
        """Compute P_b(x): locked inertia, drag of the locked robot, or wheel constraints W_b.

        Args:
            x: Shape, (nx,) [rad | m].
        Returns:
            P_b, (r, r).
        """
        return read_only(self.locals_at(self._one(x))[2][0])

    def metric(self, x: ArrayLike) -> Array:
        """Compute the metric M(x).

        Args:
            x: Shape, (nx,) [rad | m].
        Returns:
            (m, m), symmetric and positive.  Raises InputError if there is no metric.
        """
        return read_only(require_metric(self.form, self.locals_at(self._one(x))[1])[0])

    def curvature(self, x: ArrayLike) -> Array:
        """Compute the curvature B_αβ = ∂_αA_β − ∂_βA_α − [A_α, A_β] − c^γ_αβ A_γ.

        The bracket is that of twists; c are structure constants, zero without balls.

        Args:
            x: Shape, (nx,) [rad | m].
        Returns:
            (r, m, m), antisymmetric in the last two axes; errors as in `local`.
        """
        terms = self.curvatures_at(self._one(x))
        return read_only((terms.exterior - terms.bracket)[0])

    def grid(self, shapes: ArrayLike) -> ConnectionField:
        """Return the connection at many shapes, as a field over the leading axes.

        Args:
            shapes: Shapes, (..., nx) [rad | m].
        Returns:
            The field.
        """
        x = self._shapes(shapes, f"shapes of {self.form.what}").copy()
        return ConnectionField(self, read_only(x))

    def velocity(self, x: ArrayLike, xdot: ArrayLike) -> Array:
        """Compute the body twist ξ = −A ẋ.

        Args:
            x: Shapes, (..., nx) [rad | m].
            xdot: Shape rates, (..., m) [rad/s | m/s].
        Returns:
            (..., r); errors as in `local`.
        Raises:
            InputError: x and xdot differ in shape.
        """
        x = self._shapes(x, "x")
        xdot = vectors(xdot, self.m, "xdot", self.joints)
        if x.shape[:-1] != xdot.shape[:-1]:
            raise InputError(f"x and xdot differ in shape, {x.shape} and {xdot.shape}")
        xi = self.horizontal(x.reshape(-1, self.nx), xdot.reshape(-1, self.m))[0]
        return xi.reshape(*x.shape[:-1], self.r)

    def horizontal(self, x: Array, xdot: Array) -> tuple[Array, Array]:
        """Compute ξ = −A ẋ and ẋᵀ M ẋ; errors as in `local`.

        Args:
            x: Shapes, (N, nx) [rad | m].
            xdot: Shape rates, (N, m) [rad/s | m/s].
        Returns:
            ξ (N, r) and ẋᵀ M ẋ (N,), which is NaN without a metric.
        """
        values = self.code.velocities(x, xdot)
        refuse_singular(self.form, x, values.health)
        return values.xi, values.square

    def horizontal_slopes(self, x: Array, xdot: Array) -> Array:
        """Compute the exact derivatives of (ξ, ẋᵀ M ẋ) along the frame and with respect to ẋ.

        Args:
            x: Shapes, (N, nx) [rad | m].
            xdot: Shape rates, (N, m) [rad/s | m/s].
        Returns:
            (N, r + 1, 2m), or (N, r, 2m) without a metric.
        """
        return self.code.velocity_slopes(x, xdot)

    def locals_at(self, x: Array) -> tuple[Array, Array | None, Array]:
        """Compute A, M and P_b; errors as in `local`.

        Args:
            x: Shapes, (N, nx) [rad | m].
        Returns:
            A (N, r, m), M (N, m, m) or None, and P_b (N, r, r).
        """
        terms = self.code.locals(x)
        refuse_singular(self.form, x, terms.health)
        return terms.A, terms.M, terms.P

    def curvatures_at(self, x: Array) -> Curvatures:
        """Compute both terms of the curvature; errors as in `local`.

        Args:
            x: Shapes, (N, nx) [rad | m].
        Returns:
            The terms, (N, r, m, m) each.
        """
        terms = self.code.curvatures(x)
        refuse_singular(self.form, x, terms.health)
        return terms

    def _one(self, x: ArrayLike) -> Array:
        what = f"shape x of {self.form.what}"
        return self.space.normalized(vector(x, self.nx, what, self.space.x_names), what)[None]

    def _shapes(self, x: ArrayLike, what: str) -> Array:
        return self.space.normalized(vectors(x, self.nx, what, self.space.x_names), what)
