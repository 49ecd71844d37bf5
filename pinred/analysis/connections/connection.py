"""Connection: the rule by which a motion of the shape moves the body, wherever it comes from."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ...common.arrays import Array, read_only, vector, vectors
from ...common.errors import InputError, SingularInertiaError, SymmetryError
from ...kernels.connection.code import ConnectionCode, Curvatures
from ...kernels.connection.form import ConnectionForm
from ...lie.group import Group
from ...reduction.potential import broken_by_gravity
from ...system.system import System
from .fluid import Ellipse, Ellipsoid, fluid_form
from .mechanical import mechanical_code
from .other_frames import from_link, in_section
from .viscous import Rod, viscous_form
from .wheels import Rolling, Wheel, kinematic_form

_EXPLAINED = 16.0 * np.finfo(float).eps  # least own part of an inertia that is not singular
_WHEELS = 1e-9  # least health of a form that is not symmetric


@dataclass(frozen=True, eq=False)
class ConnectionField:
    """A connection at shapes x (..., m), the leading axes first in every array.

    Each array is computed when it is first looked at, kept, and read-only.  Everything raises
    SingularInertiaError, naming the first shape at which A is not defined.
    """

    connection: Connection = field(repr=False)
    x: Array

    @property
    def local(self) -> Array:
        """A, (..., r, m)."""
        return self._locals[0]

    @property
    def metric(self) -> Array:
        """M, (..., m, m).  Raises InputError if the connection has no metric."""
        found = self._locals[1]
        if found is None:
            raise InputError(f"{self.connection.form.what} give no metric on shape space")
        return found

    @cached_property
    def curvature(self) -> Array:
        """B_αβ = ∂_αA_β − ∂_βA_α − [A_α, A_β], (..., r, m, m)."""
        B, health = self.connection.code.curvature(self._flat)
        self.connection.refuse_singular(self._flat, health)
        return self._shaped(B)

    @property
    def exterior(self) -> Array:
        """∂_αA_β − ∂_βA_α, (..., r, m, m): the part that a commutative group has, too."""
        return self._parts[0]

    @property
    def bracket(self) -> Array:
        """[A_α, A_β], (..., r, m, m): curvature = exterior − bracket."""
        return self._parts[1]

    @cached_property
    def _locals(self) -> tuple[Array, Array | None]:
        A, M, _ = self.connection.locals_at(self._flat)
        return self._shaped(A), None if M is None else self._shaped(M)

    @cached_property
    def _parts(self) -> tuple[Array, Array]:
        found = self.connection.curvatures_at(self._flat)
        return self._shaped(found.exterior), self._shaped(found.bracket)

    @property
    def _flat(self) -> Array:
        return self.x.reshape(-1, self.connection.m)

    def _shaped(self, array: Array) -> Array:
        return read_only(array.reshape(*self.x.shape[:-1], *array.shape[1:]))


@dataclass(frozen=True, eq=False)
class Connection:
    """A local connection on G × B: horizontal motion is ξ = −A(x) ẋ.

    ξ: body twist of the base, (r,), [linear; angular].  Its curvature is
    B_αβ = ∂_αA_β − ∂_βA_α − [A_α, A_β] (r, m, m), with the bracket of body twists.  It comes from
    momenta, drag or fluid (then it has a metric M on shape space as well: inertia, or
    dissipation), or from wheels.  Everything is evaluated by machine code that Pinocchio has
    judged; it is compiled when it is first used.  turned_by_gravity: why momenta are not
    conserved, so that A is geometry alone and no motion follows it; empty if they are.
    """

    form: ConnectionForm = field(repr=False)
    code: ConnectionCode = field(repr=False)
    system: System | None = field(default=None, repr=False)
    is_mechanical: bool = field(default=False, repr=False)
    turned_by_gravity: str = field(default="", repr=False)

    @classmethod
    def of(cls, form: ConnectionForm) -> Connection:
        """Return the connection of a form of velocities."""
        return cls(form, ConnectionCode(form))

    @classmethod
    def mechanical(cls, system: System) -> Connection:
        """Return the mechanical connection of a system: A = I⁻¹ H_bs, metric M (kg m², …)."""
        code = mechanical_code(system)
        gravity = broken_by_gravity(system)
        return cls(code.form, code, system, is_mechanical=True, turned_by_gravity=gravity)

    @classmethod
    def viscous(cls, system: System, drag: Mapping[str, Rod | ArrayLike]) -> Connection:
        """Return the connection of a robot at low Reynolds number, where drag rules.

        drag: of links by name, a Rod, or a symmetric tensor (6, 6) from twists to what resists
        them [N s/m, N s, N m s], in the link's frame about its origin.  With the metric
        M, ẋᵀ M ẋ is the power that is dissipated [W].
        """
        return replace(cls.of(viscous_form(system, drag)), system=system)

    @classmethod
    def fluid(
        cls, system: System, density: float, bodies: Mapping[str, Ellipsoid | Ellipse | ArrayLike]
    ) -> Connection:
        """Return the connection of a robot in a perfect fluid, by added masses.

        density: of the fluid [kg/m³]; of an Ellipse [kg/m²] if masses are per metre of height.
        bodies: of links by name, an Ellipsoid, an Ellipse, or the added inertia per density as a
        symmetric tensor (6, 6) in the link's frame.  Bodies do not see each other's flow.
        """
        return replace(
            cls.of(fluid_form(system, density, bodies)), system=system,
            turned_by_gravity=broken_by_gravity(system),
        )  # fmt: skip

    @classmethod
    def kinematic(cls, system: System, wheels: Sequence[Wheel | Rolling]) -> Connection:
        """Return the connection of wheels, as many as the group has dimensions: A = W_b⁻¹ W_s.

        It has no metric.  Shapes at which the wheels leave a motion open are refused.
        """
        return replace(cls.of(kinematic_form(system, wheels)), system=system)

    def seen_from(self, link: str) -> Connection:
        """Return the same connection with another link as the base, whose twist ξ then is.

        A cycle that begins at x₀ has the phase h(x₀)⁻¹ g h(x₀), h the pose of the link as the old
        base sees it.  Raises InputError for a link that there is not, or that leaves the group.
        """
        if self.system is None:
            raise InputError("only a connection made from a System can be seen from a link")
        return self._moved(from_link(self.form, self.system, link))

    def in_section(self, pose: Callable[[ca.SX], ca.SX]) -> Connection:
        """Return the same connection in the frame h(x): A′ = Ad_{h⁻¹} A − h⁻¹∂h.

        pose: writes the pose coordinates of h, (size,), as CasADi expressions in x (m,).
        """
        return self._moved(in_section(self.form, pose))

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
        found = self.curvatures_at(self._one(x))
        return read_only((found.exterior - found.bracket)[0])

    def grid(self, shapes: ArrayLike) -> ConnectionField:
        """Return the connection at shapes (..., m), as a field over the leading axes."""
        x = vectors(shapes, self.m, f"shapes of {self.form.what}", self.joints).copy()
        return ConnectionField(self, read_only(x))

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

    def curvatures_at(self, x: Array) -> Curvatures:
        """Return the curvature in its two parts at shapes (N, m); errors as of `local`."""
        found = self.code.curvatures(x)
        self.refuse_singular(x, found.health)
        return found

    def refuse_gravity(self) -> None:
        """Raise SymmetryError if gravity changes the momenta, so that no motion is horizontal."""
        if self.turned_by_gravity:
            raise SymmetryError(f"momenta do not stay what they are: {self.turned_by_gravity}")

    def refuse_singular(self, x: Array, health: Array) -> None:
        """Raise SingularInertiaError, naming a shape, if one of (N, m) is singular."""
        least = _EXPLAINED if self.form.symmetric else _WHEELS
        size = health if self.form.symmetric else np.abs(health)
        wrong = ~(size > least)
        if wrong.any():
            at = x[int(np.argmax(wrong))]
            raise SingularInertiaError(
                f"A is not defined at the shape {at}: {self.form.what} leave a motion of the "
                "body open there; keep the joints away from it"
            )

    def refuse_crossing(self, health: Array) -> None:
        """Raise SingularInertiaError if P_b is singular between the shapes (N,) of a path.

        A form that is not symmetric changes its sign there.
        """
        if not self.form.symmetric and health.min() < 0.0 < health.max():
            raise SingularInertiaError(
                f"the gait crosses shapes at which {self.form.what} leave a motion of the body "
                "open; choose one that stays on one side of them"
            )

    def _moved(self, form: ConnectionForm) -> Connection:
        return replace(Connection.of(form), turned_by_gravity=self.turned_by_gravity)

    def _one(self, x: ArrayLike) -> Array:
        return vector(x, self.m, f"shape x of {self.form.what}", self.joints)[None]
