"""Connection: the rule by which a motion of the shape moves the body, wherever it comes from."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from ...common.arrays import Array, read_only, vector, vectors
from ...common.errors import InputError, SingularInertiaError
from ...kernels.connection.code import ConnectionCode
from ...kernels.connection.form import ConnectionForm
from ...lie.group import Group
from ...system.system import System
from .mechanical import mechanical_form

_EXPLAINED = 16.0 * np.finfo(float).eps  # least own part of an inertia that is not singular
_WHEELS = 1e-9  # least health of a form that is not symmetric


@dataclass(frozen=True, eq=False)
class ConnectionField:
    """A connection at shapes x (..., m), the leading axes first in every array; read-only.

    local: (..., r, m), A.  metric: (..., m, m), M, or None without one.  exterior: (..., r, m, m),
    ∂_αA_β − ∂_βA_α.  bracket: (..., r, m, m), [A_α, A_β].  curvature: exterior − bracket.
    """

    connection: Connection = field(repr=False)
    x: Array
    local: Array
    metric: Array | None
    exterior: Array
    bracket: Array

    @property
    def curvature(self) -> Array:
        """B_αβ = ∂_αA_β − ∂_βA_α − [A_α, A_β], (..., r, m, m)."""
        return np.asarray(self.exterior - self.bracket)


@dataclass(frozen=True, eq=False)
class Connection:
    """A local connection on G × B: horizontal motion is ξ = −A(x) ẋ.

    ξ: body twist of the base, (r,), [linear; angular].  Its curvature is
    B_αβ = ∂_αA_β − ∂_βA_α − [A_α, A_β] (r, m, m), with the bracket of body twists.  It comes from
    momenta, drag or fluid (then it has a metric M on shape space as well: inertia, or
    dissipation), or from wheels.  Everything is evaluated by machine code that Pinocchio has
    judged; it is compiled when it is first used.
    """

    form: ConnectionForm = field(repr=False)
    code: ConnectionCode = field(repr=False)

    @classmethod
    def of(cls, form: ConnectionForm) -> Connection:
        """Return the connection of a form of velocities."""
        return cls(form, ConnectionCode(form))

    @classmethod
    def mechanical(cls, system: System) -> Connection:
        """Return the mechanical connection of a system: A = I⁻¹ H_bs, metric M (kg m², …)."""
        return cls.of(mechanical_form(system))

    def __repr__(self) -> str:
        return f"Connection({self.form.what}, {self.group.name}, m={self.m})"

    @property
    def group(self) -> Group:
        """The symmetry group."""
        return self.form.group

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the shape coordinates."""
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
    def has_metric(self) -> bool:
        """Whether there is a metric on shape space."""
        return self.form.symmetric

    def local(self, x: ArrayLike) -> Array:
        """A(x), (r, m).  Raises ShapeError; SingularInertiaError where A is not defined."""
        return read_only(self.locals_at(self._one(x))[0][0])

    def locked(self, x: ArrayLike) -> Array:
        """P_b(x), (r, r): locked inertia, drag of the frozen shape, or rows of the wheels."""
        return read_only(self.locals_at(self._one(x))[2][0])

    def metric(self, x: ArrayLike) -> Array:
        """M(x), (m, m), symmetric and positive.  Raises InputError if there is no metric."""
        found = self.locals_at(self._one(x))[1]
        if found is None:
            raise InputError(f"{self.form.what} give no metric on shape space")
        return read_only(found[0])

    def curvature(self, x: ArrayLike) -> Array:
        """B(x), (r, m, m), antisymmetric in the last two axes; errors as of `local`."""
        x = self._one(x)
        found = self.code.curvatures(x)
        self.refuse_singular(x, found.health)
        return read_only((found.exterior - found.bracket)[0])

    def grid(self, shapes: ArrayLike) -> ConnectionField:
        """Return everything at shapes (..., m); errors as of `local`, naming the first shape."""
        x = vectors(shapes, self.m, f"shapes of {self.form.what}", self.joints).copy()
        flat = x.reshape(-1, self.m)
        A, M, _ = self.locals_at(flat)
        curved = self.code.curvatures(flat)
        self.refuse_singular(flat, curved.health)
        lead = x.shape[:-1]

        def shaped(array: Array) -> Array:
            return read_only(array.reshape(*lead, *array.shape[1:]))

        return ConnectionField(
            connection=self, x=read_only(x), local=shaped(A),
            metric=None if M is None else shaped(M),
            exterior=shaped(curved.exterior), bracket=shaped(curved.bracket),
        )  # fmt: skip

    def velocity(self, x: ArrayLike, xdot: ArrayLike) -> Array:
        """ξ = −A ẋ at shapes and rates (..., m), (..., r); errors as of `local`."""
        x = vectors(x, self.m, "x", self.joints)
        xdot = vectors(xdot, self.m, "xdot", self.joints)
        if x.shape != xdot.shape:
            raise InputError(f"x and xdot differ in shape, {x.shape} and {xdot.shape}")
        return self.horizontal(x.reshape(-1, self.m), xdot.reshape(-1, self.m))[0].reshape(
            *x.shape[:-1], self.r
        )

    def horizontal(self, x: Array, xdot: Array) -> tuple[Array, Array]:
        """Return ξ (N, r) and ẋᵀ M ẋ (N,) at shapes and rates (N, m); errors as of `local`.

        The squares are NaN where there is no metric.
        """
        found = self.code.velocities(x, xdot)
        self.refuse_singular(x, found.health)
        return found.xi, found.square

    def horizontal_slopes(self, x: Array, xdot: Array) -> Array:
        """Return the exact derivatives of (ξ, ẋᵀ M ẋ) by (x, ẋ), (N, r + 1, 2m).

        r rows where there is no metric.
        """
        return self.code.velocity_slopes(x, xdot)

    def locals_at(self, x: Array) -> tuple[Array, Array | None, Array]:
        """Return A (N, r, m), M (N, m, m) or None, and P_b (N, r, r); errors as of `local`."""
        found = self.code.locals(x)
        self.refuse_singular(x, found.health)
        return found.A, found.M, found.P

    def refuse_singular(self, x: Array, health: Array) -> None:
        """Raise SingularInertiaError, naming a shape, if one of (N, m) is singular.

        Of a form that is not symmetric also if the sign changes between two shapes in a row.
        """
        least = _EXPLAINED if self.form.symmetric else _WHEELS
        size = health if self.form.symmetric else np.abs(health)
        wrong = ~(size > least)
        if wrong.any():
            at = x[int(np.argmax(wrong))]
            raise SingularInertiaError(
                f"A is not defined at the shape {at}: {self.form.what} leave a motion of the "
                "body open there; keep the joints away from it"
            )

    def _one(self, x: ArrayLike) -> Array:
        return vector(x, self.m, f"shape x of {self.form.what}", self.joints)[None]
