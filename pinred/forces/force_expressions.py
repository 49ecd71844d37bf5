"""The forces and prescribed joints of a scene as one set of CasADi expressions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import casadi as ca

from ..common.errors import InputError
from ..common.parameter import parameter_of
from ..reduction.tree.all_joints import shape_gradient
from ..system.force_interface import Load
from ..system.system import System
from .columns import symbols_of, terms_of, through, torque_column, wrench_column
from .force import Force, Terms
from .force_numbers import ForceNumbers, RobotSymbols
from .kinds import Controller
from .link_wrenches import of_load
from .prescribed_joints import Plan, prescribed_motion, prescribed_rates


class ForceExpressions:
    """Sums and lists of the terms of all forces in a scene.

    Attributes:
        symbols: Variables of the forces.
        base: Symbols of pose, twist, body momentum and spatial momentum of the base in space.
        joints: Indices of the rates of the prescribed joints.
        motion: Coordinates, rates and accelerations of the prescribed joints.
        potential: Sum of the potentials.
        torques: Torques on the shape, (m, F), one column per force that does work.
        wrenches: Wrenches on the base, (r, F).
        direct: Torques and wrenches without the loads on links, (m + r,) for each force.
        loads: Wrenches on links, or along fixed axes.
        inverse: Accelerations (m,) that forces request, and the torques that inverse dynamics
            computes for them.
        held: Controllers, each with the slice of the numbers that its commands set.
        labels: Labels of the forces that do work.
        acting_on_base: Labels of the forces that act on the base.
        acted: Indices of the joints that forces act on.
    """

    def __init__(
        self,
        system: System,
        forces: Sequence[Force],
        prescribed: Mapping[str, Plan],
        robot: RobotSymbols,
        numbers: ForceNumbers,
        within: ca.SX | None,
    ) -> None:
        """Collect the terms of all forces.

        Args:
            system: The robot.
            forces: Forces and controllers.
            prescribed: Motions of joints by name.
            robot: Symbols of the robot parameters.
            numbers: Symbols of the numbers in forces; this constructor adds symbols.
            within: Time that selects the segment of tabulated signals, None without tables.
        Raises:
            InputError: A force or a prescribed motion does not fit the system.
        """
        self._system, self._robot, self._numbers = system, robot, numbers
        self.symbols, self.base = symbols_of(system, within)
        self.joints = prescribed_rates(system, prescribed)
        self.motion = prescribed_motion(prescribed, self.symbols, numbers.symbol)
        self.potential = ca.SX(0)
        self.torques, self.wrenches = ca.SX(system.m, 0), ca.SX(system.r, 0)
        self.direct: list[ca.SX] = []
        self.loads: list[Load] = []
        self.inverse: list[tuple[ca.SX, ca.SX]] = []
        self.held: list[tuple[Controller, slice]] = []
        self.labels: list[str] = []
        self.acting_on_base: list[str] = []
        self.acted: set[int] = set()
        for force in sorted(forces, key=lambda force: force.last):
            if force.last:
                if sum(other.last for other in forces) > 1:
                    raise InputError(f"{force.label}: only one force may depend on all others")
                self._prepare_last()
            self._add(force)

    def _prepare_last(self) -> None:
        """Give the last force access to the sum of the other forces and to inverse dynamics."""
        s = self.symbols
        accelerations = zip(self.joints, ca.vertsplit(self.motion[2]), strict=True)
        self.symbols = replace(
            s,
            others=ca.sum2(self.torques) - shape_gradient(self._system, self.potential, s.x),
            accelerations=dict(accelerations),
            required_torque=self._required_torque,
            loop_motion=self._loop_motion if self._system.loops else None,
        )

    def _required_torque(self, accelerations: Mapping[int, ca.SX]) -> ca.SX:
        """Return the torques (m,) that produce joint accelerations, and store both."""
        from .inverse_dynamics import required_torque  # its imports are slow

        joints = sorted(accelerations)
        requested = ca.vertcat(*(accelerations[k] for k in joints))
        if self._system.loops:
            from .loop_dynamics import loop_motion

            G, drift = loop_motion(self._system, self.symbols, joints)
            requested = G @ requested + drift
        torque = required_torque(self._system, self._robot, self.symbols, requested)
        self.inverse.append((requested, torque))
        return torque

    def _loop_motion(self, independent: Sequence[int]) -> ca.SX:
        """Return G, (m, k), with ẋ = G u̇ for the rates of independent joints."""
        from .loop_dynamics import loop_motion

        return loop_motion(self._system, self.symbols, independent)[0]

    def _add(self, force: Force) -> None:
        """Add the terms of a force."""
        system, s, r = self._system, self.symbols, self._system.r
        first = len(self._numbers)
        terms = terms_of(force, s, self._numbers.symbol)
        self._check_symbols(terms, force.label)
        if isinstance(force, Controller):
            self.held.append((force, slice(first, first + force.count(s.names, r))))
        if terms.potential is not None:
            self.potential = self.potential + terms.potential
        if not (terms.torque or terms.wrench is not None or terms.loads):
            return
        self.labels.append(force.label)
        torque, wrench = torque_column(terms, system), wrench_column(terms, r)
        self.direct.append(ca.vertcat(torque, wrench))
        for load in terms.loads:
            on_coordinates = of_load(system, self._robot, s, load, force.label)
            torque, wrench = torque + on_coordinates.torque, wrench + on_coordinates.wrench
            self.acted |= {k for k in range(system.m) if not on_coordinates.torque[k].is_zero()}
        self.loads += terms.loads
        self.torques = ca.horzcat(self.torques, torque)
        self.wrenches = ca.horzcat(self.wrenches, wrench)
        if terms.wrench is not None or terms.loads:
            self.acting_on_base.append(force.label)
        self.acted |= {i for k in terms.torque for i, _ in through(system, k)}

    def _check_symbols(self, terms: Terms, label: str) -> None:
        """Raise InputError if a force contains a symbol that is not among its arguments."""
        s = self.symbols
        seen = (s.seen.pose, s.seen.xi, s.seen.mu, s.seen.J)
        allowed = ca.vertcat(
            s.t, s.x, s.xdot, s.xi, s.mu, *seen, *self._numbers.symbols, self._robot.column
        )
        hashes = {symbol.element_hash() for symbol in ca.symvar(allowed)}
        for symbol in ca.symvar(ca.SX(ca.vertcat(*terms.expressions))):
            if symbol.element_hash() in hashes:
                continue
            parameter = parameter_of(symbol)
            if parameter is None:
                raise InputError(
                    f"{label} has a symbol '{symbol}' that is none of t, x, xdot and mu; "
                    "use the arguments of the function"
                )
            self._numbers.symbol(parameter)

    @property
    def variables(self) -> list[ca.SX]:
        """Arguments of all compiled functions: those of ForceInputs, then the robot parameters."""
        s = self.symbols
        p = ca.vertcat(*self._numbers.symbols)
        return [s.t, s.x, s.xdot, s.xi, s.mu, p, *self.base, self._robot.column]
