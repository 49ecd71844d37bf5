"""Connection: the linear map from shape rates to the body twist, from any kind of physics."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import casadi as ca
from numpy.typing import ArrayLike

from ...common.argument_kinds import checks_arguments
from ...common.errors import InputError, SymmetryError
from ...common.memo import once
from ...kernels.connection.connection_code import ConnectionCode
from ...kernels.connection.connection_form import ConnectionForm
from ...reduction.potential import broken_by_gravity
from ...system.system import System, checked_system
from .connection_values import ConnectionValues
from .fluid import Ellipse, Ellipsoid, Rod, fluid_form, viscous_form
from .loop_connection import code_with_loops, refuse_moved_loops
from .mechanical_connection import mechanical_code
from .other_frames import from_link, in_section
from .rotation_chart import RotationChart, chart_about
from .wheels import Rolling, Wheel, kinematic_form


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
