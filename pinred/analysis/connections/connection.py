"""Connection: the linear map from shape rates to the body twist, from any kind of physics."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import casadi as ca
from numpy.typing import ArrayLike

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, read_only, vector, vectors
from ...common.errors import InputError, SymmetryError
from ...common.memo import once
from ...kernels.connection.connection_code import ConnectionCode, Curvatures
from ...kernels.connection.connection_form import ConnectionForm
from ...lie.group import Group
from ...reduction.potential import broken_by_gravity
from ...system.shape_space import ShapeSpace
from ...system.system import System
from .connection_summary import ConnectionSummary
from .fluid import Ellipse, Ellipsoid, Rod, fluid_form, viscous_form
from .loop_connection import code_with_loops, refuse_moved_loops
from .other_frames import from_link, in_section
from .rotation_chart import RotationChart, chart_about
from .singular_shapes import refuse_singular, require_metric
from .wheels import Rolling, Wheel, kinematic_form


@checks_arguments
@dataclass(frozen=True, eq=False)
class ConnectionField:
    """A connection at many shapes, with the leading axes of x first in every array.

    Arrays are cached and read-only; SingularInertiaError is raised where A is not defined.

    Attributes:
        connection: The connection.
        x: Shapes, (..., nx) [rad | m].
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
@dataclass(frozen=True, eq=False, repr=False)
class Connection(ConnectionSummary):
    """A local connection on G × B: horizontal motion is ξ = −A(x) ẋ.

    ξ is the body twist of the base, (r,) [linear; angular].  ẋ are rates along the frame of the
    shape space, (m,): the derivatives of hinges and slides, and the angular velocities of balls in
    the axes of their children.  Momenta, drag and fluid also define a metric M on shape space.

    Attributes:
        form: Linear form of the velocities (ξ, ẋ) that vanishes on horizontal motions.
        code: Compiled code that evaluates the form.
        system: The system, if the connection was built from one.
        is_mechanical: Whether it is the mechanical connection.
        turned_by_gravity: Reason why gravity changes the momenta; empty if it does not.
        chart: Coordinates of `in_chart`; None if the shapes are those of the system.
    """

    form: ConnectionForm
    code: ConnectionCode
    system: System | None = None
    is_mechanical: bool = False
    turned_by_gravity: str = ""
    chart: RotationChart | None = None

    @classmethod
    def of(cls, form: ConnectionForm) -> Connection:
        """Return the connection of a form of velocities.

        Args:
            form: Form that vanishes on horizontal motions.
        Returns:
            The connection.
        """
        return cls(form, ConnectionCode(form))

    @classmethod
    def mechanical(cls, system: System, *, independent: Sequence[str] | None = None) -> Connection:
        """Return the mechanical connection of a system, A = I⁻¹ H_bs.

        Args:
            system: The system.
            independent: Joints of a robot with loops, as many as `System.shape_dim`, whose
                coordinates are the shapes; None: chosen where the loops were assembled.
        Returns:
            The connection, with the reduced metric [kg m² | kg m | kg].
        """
        code, tree = code_with_loops(system, independent), None if system.loops else system
        gravity = broken_by_gravity(system)
        return cls(code.form, code, tree, is_mechanical=True, turned_by_gravity=gravity)

    @classmethod
    def viscous(cls, system: System, drag: Mapping[str, Rod | ArrayLike]) -> Connection:
        """Return the connection of a robot at low Reynolds number, where drag dominates.

        Args:
            system: The system.
            drag: {link: Rod or tensor}.  A tensor (6, 6) is symmetric and maps the link's twist to
                the drag force and moment [N s/m, N s, N m s], in the link's frame about its origin.
        Returns:
            The connection.  Its metric defines the dissipated power ẋᵀ M ẋ [W].
        """
        return replace(cls.of(viscous_form(system, drag)), system=system)

    @classmethod
    def fluid(
        cls, system: System, density: float, bodies: Mapping[str, Ellipsoid | Ellipse | ArrayLike]
    ) -> Connection:
        """Return the connection in a perfect fluid; the added masses ignore other bodies.

        Args:
            system: The system.
            density: Density of the fluid [kg/m³]; for Ellipses, mass per area of the plane [kg/m²].
            bodies: {link: Ellipsoid, Ellipse or tensor}.  A tensor (6, 6) is symmetric and is the
                added inertia per density in the link's frame.
        Returns:
            The connection, with a metric.
        """
        flow = replace(cls.of(fluid_form(system, density, bodies)), system=system)
        return replace(flow, turned_by_gravity=broken_by_gravity(system))

    @classmethod
    def kinematic(cls, system: System, wheels: Sequence[Wheel | Rolling]) -> Connection:
        """Return the connection of wheels, A = W_b⁻¹ W_s.

        Args:
            system: The system.
            wheels: Wheels, as many as the group has dimensions.
        Returns:
            The connection, without metric.
        """
        return replace(cls.of(kinematic_form(system, wheels)), system=system)

    def seen_from(self, link: str) -> Connection:
        """Return the same connection with another link as the base; ξ is then its twist.

        A cycle from x₀ then has the phase h(x₀)⁻¹ g h(x₀); h: pose relative to the old base.

        Args:
            link: Name of the link, whose motions must be in the group.
        Returns:
            The connection.
        Raises:
            InputError: The connection has no system, or the link is not admissible.
        """
        refuse_moved_loops(self.code, "Connection.seen_from")
        if self.system is None or self.chart is not None:
            raise InputError("seen_from: expected a connection of a System, without a centre")
        return self._moved(from_link(self.form, self.system, link))

    def in_section(self, pose: Callable[[ca.SX], ca.SX]) -> Connection:
        """Return the same connection in the frame h(x): A′ = Ad_{h⁻¹} A − h⁻¹∂h.

        Args:
            pose: Function of CasADi symbols (m,) that returns the pose coordinates of h, (size,).
        Returns:
            The connection.
        """
        refuse_moved_loops(self.code, "Connection.in_section")
        chart = self.in_chart()
        return replace(self._moved(in_section(chart.form, pose)), chart=chart.chart)

    def in_chart(self, centre: ArrayLike | Mapping[str, ArrayLike] | None = None) -> Connection:
        """Return the same connection in rotation vectors w of balls: x = centre · exp(w).

        Args:
            centre: Shape, (nx,), or {joint: value}, as for x0; by default the shape at rest.
        Returns:
            The connection over w, (m,); itself without balls and centre.
        Raises:
            InputError: The centre is invalid, or the connection already has one.
        """
        if centre is None and not self.space.balls:
            return self
        refuse_moved_loops(self.code, "Connection.in_chart")
        chart = chart_about(self.space, self.system, centre, self.chart)
        code = once(self, chart.centre.tobytes(), partial(chart.code_of, self.form))
        return replace(self, form=code.form, code=code, chart=chart)

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

    def refuse_gravity(self) -> None:
        """Raise SymmetryError if gravity changes the momenta, so that no motion is horizontal."""
        if self.turned_by_gravity:
            raise SymmetryError(f"momenta are not conserved: {self.turned_by_gravity}")

    def _moved(self, form: ConnectionForm) -> Connection:
        return replace(Connection.of(form), turned_by_gravity=self.turned_by_gravity)

    def _one(self, x: ArrayLike) -> Array:
        what = f"shape x of {self.form.what}"
        return self.space.normalized(vector(x, self.nx, what, self.space.x_names), what)[None]

    def _shapes(self, x: ArrayLike, what: str) -> Array:
        return self.space.normalized(vectors(x, self.nx, what, self.space.x_names), what)
