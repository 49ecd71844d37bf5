"""Connection: the linear map from shape rates to the body twist, from any kind of physics.

Arguments of analyses are a connection, or a system that stands for its mechanical connection.

A connection can be stated in another frame: another link as the base, or another section.

A frame with the pose h(x) ∈ G relative to the base moves with g′ = g h, so that

    ξ′ = Ad_{h⁻¹} ξ + h⁻¹ḣ,   A′ = Ad_{h⁻¹} A − h⁻¹∂h,   B′ = Ad_{h⁻¹} B,

and a cycle from x₀ has the phase h(x₀)⁻¹ g h(x₀).

Shapes at which a connection is not defined are rejected.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ...common.argument_kinds import call_function, checks_arguments
from ...common.arrays import Array, central_differences, read_only, vector, vectors
from ...common.errors import InputError, SingularInertiaError, SymmetryError
from ...common.html import Rows, Summary
from ...common.memo import once
from ...kernels.connection.connection_code import ConnectionCode, Curvatures
from ...kernels.connection.connection_form import ConnectionForm, form_of
from ...lie.group import Group
from ...reduction.potential import broken_by_gravity
from ...reduction.tree.momenta import in_space, root_twist
from ...system.coordinates import ShapeSpace
from ...system.system import System, checked_system
from .drag_fluid_and_wheels import (
    Ellipse,
    Ellipsoid,
    Rod,
    Rolling,
    Wheel,
    fluid_form,
    kinematic_form,
    link_jacobian,
    link_named,
    mechanical_code,
    viscous_form,
)
from .loop_connection import LoopConnectionCode, code_with_loops, refuse_moved_loops
from .rotation_chart import RotationChart, chart_about

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


Twist = Callable[[ca.SX, ca.SX, ca.SX], ca.SX]
_STEP = 5e-3  # step of the finite differences of order 6 [rad | m]
_OUTSIDE = 1e-9  # largest motion outside the group that counts as zero, relative to the Jacobian
_SAMPLES = 5  # number of random shapes at which motions are checked


def from_link(form: ConnectionForm, system: System, name: str) -> ConnectionForm:
    """Express a form in terms of the twist of a link instead of the twist of the root.

    Args:
        form: The form.
        system: The system.
        name: Name of the link.
    Returns:
        The new form.
    Raises:
        InputError: The link is unknown, or its motions are not in the group.
    """
    link, group = link_named(system, name, "the base"), system.group
    axes = list(group.axes)

    def entries(x: Array) -> Array:
        """Return the matrix that maps (ξ, ẋ) to ξ′, (r, n)."""
        J = link_jacobian(system, link, x)
        outside = [k for k in range(6) if k not in axes]
        if np.abs(J[outside]).max(initial=0.0) > _OUTSIDE * np.abs(J).max():
            raise InputError(
                f"'{name}' cannot be the base of '{system.name}': it has motions that are not in "
                f"{group.name}"
            )
        return J[axes]

    rng = np.random.default_rng(0)
    for _ in range(_SAMPLES):
        entries(system.space.random(rng, np.pi))

    def old(x: ca.SX, xi: ca.SX, xdot: ca.SX) -> ca.SX:
        return root_twist(system, x, link.joint - 1, link.placement, xi, xdot)

    return _transformed(form, old, entries, f"{form.what}, seen from '{name}'")


def in_section(form: ConnectionForm, pose: Callable[[ca.SX], ca.SX]) -> ConnectionForm:
    """Express a form in terms of the twist of a frame h(x) instead of the twist of the root.

    Args:
        form: The form.
        pose: Returns the pose coordinates of h, (size,), as CasADi expressions of x (m,).
    Returns:
        The transformed form.
    Raises:
        InputError: `pose` fails, or returns a wrong number of coordinates.
    """
    group, m = form.group, form.m
    y = ca.SX.sym("x", m)
    value = call_function(lambda y: ca.densify(ca.SX(pose(y))), "the section of a Connection", y)
    h = ca.Function("h", [y], [value])
    if h.numel_out(0) != group.size:
        raise InputError(
            f"a section of {group.name} gives {group.size} pose coordinates "
            f"({', '.join(group.pose_names)}), got {h.numel_out(0)}"
        )

    def at(x: Array) -> Array:
        return np.asarray(h(x)).ravel()

    def entries(x: Array) -> Array:
        inverse = group.inverse(at(x))

        def log_from(y: Array) -> Array:
            return group.log(group.compose(inverse, at(y)))

        return np.hstack([group.Ad(inverse), central_differences(log_from, x, _STEP)])

    def old(x: ca.SX, xi: ca.SX, xdot: ca.SX) -> ca.SX:
        value = h(x)
        R, p = _rotation(group, value), _translation(group, value)
        skew = R.T @ ca.reshape(ca.jtimes(ca.vec(R), x, xdot), 3, 3)
        linear, angular = in_space(group, xi)
        w = ca.vertcat(*angular) - ca.vertcat(skew[2, 1], skew[0, 2], skew[1, 0])
        v = ca.vertcat(*linear) - R.T @ ca.jtimes(p, x, xdot)
        twist = ca.vertcat(R @ v + ca.cross(p, R @ w), R @ w)
        return twist[list(group.axes)]

    return _transformed(form, old, entries, f"{form.what}, in another section")


def _transformed(
    form: ConnectionForm, old: Twist, entries: Callable[[Array], Array], what: str
) -> ConnectionForm:
    """Express a form in terms of the velocities (ξ′, ẋ) of the new frame.

    Args:
        form: The form in terms of (ξ, ẋ).
        old: Returns ξ from x, ξ′ and ẋ, as CasADi expressions.
        entries: Returns the matrix that maps (ξ, ẋ) to ξ′, (r, n), at a shape.
        what: Short description for messages.
    Returns:
        The new form.
    """
    r = form.r

    def values(x: ca.SX, v: ca.SX) -> ca.SX:
        old_velocity = ca.vertcat(old(x, v[:r], v[r:]), v[r:])
        F = form.values(x, old_velocity)
        return ca.jtimes(old_velocity, v, F, True) if form.symmetric else F

    def reference(x: Array) -> Array:
        n = form.r + form.m
        change = np.eye(n)
        change[:r] = entries(x)
        T = np.linalg.inv(change)
        G = form.reference(x) @ T
        return np.asarray(T.T @ G if form.symmetric else G)

    def locked(x: ca.SX) -> ca.SX:
        xi = ca.SX.sym("xi", r)
        T = ca.densify(ca.jacobian(old(x, xi, ca.SX.zeros(form.m, 1)), xi))
        P = ca.reshape(form.locked(x), r, r) @ T
        return T.T @ P if form.symmetric else P

    return form_of(
        form.group, form.joints, form.units, what, values, reference,
        symmetric=form.symmetric, momentum=form.momentum, locked=locked, space=form.space,
    )  # fmt: skip


def _rotation(group: Group, pose: ca.SX) -> ca.SX:
    """Return the rotation matrix of a pose, (3, 3)."""
    if group.turns == 0:
        return ca.SX.eye(3)
    if group.turns == 1:
        c, s = ca.cos(pose[-1]), ca.sin(pose[-1])
        return ca.blockcat([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    x, y, z, w = (pose[group.size - 4 + k] for k in range(4))
    return ca.blockcat(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _translation(group: Group, pose: ca.SX) -> ca.SX:
    """Return the translation of a pose, (3,)."""
    entries = [ca.SX(0)] * 3
    for k, axis in enumerate(group.axes[: group.linear]):
        entries[axis] = pose[k]
    column: ca.SX = ca.vertcat(*entries)
    return column


@checks_arguments
@dataclass(frozen=True, eq=False, repr=False)
class Connection(ConnectionValues):
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
        robot = cls._of_robot(system, independent, "mechanical", mechanical_code)
        return replace(robot, is_mechanical=True, turned_by_gravity=broken_by_gravity(system))

    @classmethod
    def viscous(
        cls,
        system: System,
        drag: Mapping[str, Rod | ArrayLike],
        *,
        independent: Sequence[str] | None = None,
    ) -> Connection:
        """Return the connection of a robot at low Reynolds number, where drag dominates.

        Args:
            system: The system.
            drag: {link: Rod or tensor}.  A tensor (6, 6) is symmetric and maps the link's twist to
                the drag force and moment [N s/m, N s, N m s], in the link's frame about its origin.
            independent: Independent joints of a robot with loops, as for `mechanical`.
        Returns:
            The connection.  Its metric defines the dissipated power ẋᵀ M ẋ [W].
        """

        def code(tree: System) -> ConnectionCode:
            return ConnectionCode(viscous_form(tree, drag))

        return cls._of_robot(system, independent, "viscous", code)

    @classmethod
    def fluid(
        cls,
        system: System,
        density: float,
        bodies: Mapping[str, Ellipsoid | Ellipse | ArrayLike],
        *,
        independent: Sequence[str] | None = None,
    ) -> Connection:
        """Return the connection in a perfect fluid; the added masses ignore other bodies.

        Args:
            system: The system.
            density: Density of the fluid [kg/m³]; for Ellipses, mass per area of the plane [kg/m²].
            bodies: {link: Ellipsoid, Ellipse or tensor}.  A tensor (6, 6) is symmetric and is the
                added inertia per density in the link's frame.
            independent: Independent joints of a robot with loops, as for `mechanical`.
        Returns:
            The connection, with a metric.
        """

        def code(tree: System) -> ConnectionCode:
            return ConnectionCode(fluid_form(tree, density, bodies))

        flow = cls._of_robot(system, independent, "fluid", code)
        return replace(flow, turned_by_gravity=broken_by_gravity(system))

    @classmethod
    def kinematic(
        cls,
        system: System,
        wheels: Sequence[Wheel | Rolling],
        *,
        independent: Sequence[str] | None = None,
    ) -> Connection:
        """Return the connection of wheels, A = W_b⁻¹ W_s.

        Args:
            system: The system.
            wheels: Wheels, as many as the group has dimensions.
            independent: Independent joints of a robot with loops, as for `mechanical`.
        Returns:
            The connection, without metric.
        """

        def code(tree: System) -> ConnectionCode:
            return ConnectionCode(kinematic_form(tree, wheels))

        return cls._of_robot(system, independent, "kinematic", code)

    @classmethod
    def _of_robot(
        cls,
        system: System,
        independent: Sequence[str] | None,
        kind: str,
        code_of: Callable[[System], ConnectionCode],
    ) -> Connection:
        """Return a connection of a robot, over independent joints if it has loops."""
        system = checked_system(system, f"Connection.{kind}", loops=True)
        code = code_with_loops(system, independent, code_of)
        return cls(code.form, code, None if system.loops else system)

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

    def refuse_gravity(self) -> None:
        """Raise SymmetryError if gravity changes the momenta, so that no motion is horizontal."""
        if self.turned_by_gravity:
            raise SymmetryError(f"momenta are not conserved: {self.turned_by_gravity}")

    def _moved(self, form: ConnectionForm) -> Connection:
        return replace(Connection.of(form), turned_by_gravity=self.turned_by_gravity)


ConnectionSource: TypeAlias = Connection | System


def connection_of(source: ConnectionSource, what: str) -> Connection:
    """Return a connection, or the mechanical connection of a system.

    Args:
        source: The connection or the system.
        what: Name of the function in messages.
    Raises:
        InputError: The source is neither.
    """
    if isinstance(source, System):
        return Connection.mechanical(source)
    if not isinstance(source, Connection):
        raise InputError(
            f"{what} takes a Connection, or a System for its mechanical connection; got "
            f"{type(source).__name__}"
        )
    return source


def robot_of(connection: Connection) -> System | None:
    """Return the robot of a connection, with its loops; None if it was built without one."""
    code = connection.code
    return code.chart_system if isinstance(code, LoopConnectionCode) else connection.system


def rest_of(connection: Connection) -> Array:
    """Return the shape (m,) at rest: zero, or that at which the loops of a robot were assembled."""
    if not isinstance(connection.code, LoopConnectionCode):
        return np.zeros(connection.m)
    chart = connection.code.chart
    closure = chart.system.closure
    assert closure is not None
    return closure.x[chart.system.space.coordinates_of(chart.independent.tolist())]


def system_of(source: ConnectionSource, what: str) -> System:
    """Return a system, or the system of a mechanical connection.

    Args:
        source: The system or the connection.
        what: Name of the function in messages.
    Raises:
        InputError: The source is neither, or the connection is not mechanical.
    """
    if not isinstance(source, Connection):
        return source
    system = robot_of(source)
    if system is None or not source.is_mechanical:
        raise InputError(
            f"{what} simulates a robot by its mechanical connection, got {source.title()}; pass "
            "the System"
        )
    return system
