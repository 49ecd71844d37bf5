"""The forces and prescribed joints of a scene as CasADi expressions, with their numbers.

Wrenches on links become torques on the joints and a wrench on the base.  A force F at a point p of
a link and a moment N on it have the power F · v_p + N · ω. This power is linear in the body twist ξ
and the shape rate ẋ:

    F · v_p + N · ω = f · ξ + τ · ẋ.

The derivatives of the power are therefore the wrench f on the base and the torques τ on the joints.
Follower joints contribute through the joints they follow.

Inverse dynamics computes the torques for given accelerations, also with closed loops.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property, partial
from typing import Any

import casadi as ca
import numpy as np

from ..common.arrays import Array, read_only
from ..common.errors import InputError
from ..common.memo import once
from ..common.names import listed
from ..common.parameter import parameter_of, value_in
from ..reduction.tree.all_joints import joint_rates, joint_values, rate_map, shape_gradient
from ..reduction.tree.articulated_sweep import step_of
from ..reduction.tree.body_frames import bodies_of, moved_twist
from ..reduction.tree.free_bodies import NOTHING, Freed
from ..reduction.tree.loop_constraints import jacobian_function
from ..reduction.tree.momenta import bracket, centre_of_mass, momenta
from ..reduction.tree.scalars import (
    Rotation,
    Scalar,
    Turn,
    Vec,
    add,
    cross,
    dot,
    mul,
    plus,
    solve_spd,
)
from ..system.assembly import link_frame
from ..system.force_interface import Load
from ..system.loops.loop_assembly import equation_weights
from ..system.system import System
from .columns import (
    load_column,
    seen_of_base,
    symbols_of,
    terms_of,
    through,
    torque_column,
    wrench_column,
)
from .force import Force, Symbols, Terms
from .force_numbers import (
    Acting,
    ForceInputs,
    ForceNumbers,
    Numeric,
    Prescribed,
    RobotSymbols,
    Tables,
    numbers_of,
    random_numbers,
)
from .kinds import Controller
from .signals import Signal
from .signals.signal import Table
from .switch_times import KINKS, SwitchTimes, separate, time_within
from .time_functions import TimeFunctions
from .tracking import Plan, prescribed_motion, prescribed_rates, signals_of


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
        # A controller does not know that a joint rests at a stop.
        self._law = system.off_surfaces()
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
            loop_motion=self._loop_motion if self._law.loops else None,
        )

    def _required_torque(self, accelerations: Mapping[int, ca.SX]) -> ca.SX:
        """Return the torques (m,) that produce joint accelerations, and store both."""
        joints = sorted(accelerations)
        requested = ca.vertcat(*(accelerations[k] for k in joints))
        if self._law.loops:
            G, drift = loop_motion(self._law, self.symbols, joints)
            requested = G @ requested + drift
        torque = required_torque(self._system, self._robot, self.symbols, requested)
        self.inverse.append((requested, torque))
        return torque

    def _loop_motion(self, independent: Sequence[int]) -> ca.SX:
        """Return G, (m, k), with ẋ = G u̇ for the rates of independent joints."""
        return loop_motion(self._law, self.symbols, independent)[0]

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
            from .force_model import of_load  # its imports are slow

            load_torque, load_wrench = of_load(system, self._robot, s, load, force.label)
            torque, wrench = torque + load_torque, wrench + load_wrench
            self.acted |= {k for k in range(system.m) if not load_torque[k].is_zero()}
        self.loads += terms.loads
        self.torques = ca.horzcat(self.torques, torque)
        self.wrenches = ca.horzcat(self.wrenches, wrench)
        if terms.wrench is not None or terms.loads:
            self.acting_on_base.append(force.label)
        self.acted |= {i for k in terms.torque for i, _ in through(system, k)}

    def _check_symbols(self, terms: Terms, label: str) -> None:
        """Raise InputError if a force contains a symbol that is not among its arguments."""
        s = self.symbols
        observed = (s.seen.pose, s.seen.xi, s.seen.mu, s.seen.J)
        allowed = ca.vertcat(
            s.t, s.x, s.xdot, s.xi, s.mu, *observed, *self._numbers.symbols, self._robot.column
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


class ForceModel:
    """The forces and prescribed joints of a scene.

    Attributes:
        numbers: Values of the numbers in the forces, which may change without compiling another
            kernel, (p,).
        parameters: Parameters that the numbers depend on.
        slopes: ∂numbers/∂parameters, (p, parameters), which is constant.
        held: Controllers, each with the slice of numbers that contains its zero-order hold.
        key: Digest of the expressions, equal for models that can share a kernel.
        tables: The tables in forces and motions.
        within: Slice of the numbers that change from span to span: a time within the span, at which
            conditions on time are evaluated, and the segments of tables at this time.
        switching: The times at which functions of time are not smooth.
        joints: Indices of the rates of the prescribed joints.
        signals: Signals in the motions of the prescribed joints.
        references: Signals that the forces contain.
        touched: Joints that forces act on, or whose positions forces depend on.
        labels: Labels of the forces that do work.
        acting_on_base: Labels of the forces that act on the base. If there are any, the momentum is
            integrated.
        sees_momentum: Whether forces depend on twist or momentum of the base, as in Symbols.
        sees_attitude: Whether forces depend on the base's attitude.
        sees_place: Whether forces depend on position or velocity of the base's centre of mass.
        sees_base_momenta: Whether forces depend on twist or momenta of the base in space.
        loads: Link and axes of each wrench that does not act on the base in its own axes.
        freed: Variable robot parameters in the expressions, link frames included.
        weighed: Whether the expressions contain gravity, as inverse dynamics does.
        acting_function: (t, x, ẋ, ξ, μ, numbers, pose, twist, μ and J of the base in space, robot
            parameters) → (torque, wrench), with conditions on time evaluated at `within`.
        prescribed_function: (t, numbers) → (x, ẋ, ẍ) of the prescribed joints, likewise.
        apart_function: The same inputs → the results of `acting_apart`.
        planned_function: As `prescribed_function`, but with conditions on time evaluated at the
            time itself.
        has_potential: Whether any force has a potential.
        potential_function: (x, numbers) → V, zero without a potential.
        needs_time: Whether any force or motion depends on time or on the base's position.
    """

    def __init__(
        self,
        system: System,
        forces: Sequence[Force],
        prescribed: Mapping[str, Plan],
        freed: Freed = NOTHING,
        movable: Collection[int] = (),
    ) -> None:
        """Compile all forces.

        Args:
            system: The robot.
            forces: Forces and controllers.
            prescribed: Motions of joints by name.
            freed: Robot parameters that may vary.
            movable: Frames of links whose placements may vary.
        Raises:
            InputError: A force or a joint name is invalid.
        """
        m, r = system.m, system.r
        self._system, robot = system, RobotSymbols(system, freed, movable)
        self._unseen = (np.zeros(system.group.size), *np.zeros((3, r)))
        self.signals = tuple(s for plan in prescribed.values() for s in signals_of(plan))
        self.references = tuple(signal for force in forces for signal in force.signals)
        self.tables = Tables(_tables_among((*self.signals, *self.references)))
        numbers = ForceNumbers(self.tables if self.tables.signals else None)
        within = numbers.symbols[0] if self.tables.signals else None
        self.within = slice(0, len(numbers))
        terms = ForceExpressions(system, forces, prescribed, robot, numbers, within)
        as_written = terms.motion
        self._separate_switches(terms, numbers, within)
        self.joints, self.held, self.labels = terms.joints, terms.held, terms.labels
        self.acting_on_base = terms.acting_on_base
        self.numbers, self._in_formulas = numbers.values, numbers.in_formulas
        self.parameters = numbers.parameters()
        self.slopes = numbers.slopes(self.parameters)
        self.freed, self.weighed = robot.freed, robot.weighed
        s, state, potential = terms.symbols, terms.variables, terms.potential
        p = ca.vertcat(*numbers.symbols)
        forward: ca.SX = -shape_gradient(system, potential, s.x)
        torque, wrench = ca.sum2(terms.torques) + forward, ca.sum2(terms.wrenches)
        self.prescribed_function = _function("prescribed", [s.t, p], [*terms.motion])
        self.acting_function = _function("acting", state, [torque, wrench])
        self._acting = Numeric(self.acting_function)
        self._prescribed = Numeric(self.prescribed_function)
        self.planned_function = self.prescribed_function
        if self.switching.conditions is not None:
            self.planned_function = _function("planned", [s.t, p], [*as_written])
        self._each = Numeric(_function("each", state, [terms.torques, terms.wrenches]))
        pairs = [ca.horzcat(ca.SX(m, 0), *c) for c in zip(*terms.inverse, strict=True)]
        self._required = Numeric(_function("required", state, pairs)) if pairs else None
        self.loads = tuple((load.link, load.frame) for load in terms.loads)
        direct = ca.sum2(ca.horzcat(ca.SX(m + r, 0), *terms.direct))
        direct += ca.vertcat(forward, ca.SX(r, 1))
        # For m = 0 a slice direct[:0] would not be a column, so vertsplit is used.
        columns = ca.vertsplit(direct, [0, m, m + r])
        columns.append(ca.horzcat(ca.SX(9, 0), *map(load_column, terms.loads)))
        self.apart_function = _function("apart", state, columns)
        self._apart = Numeric(self.apart_function)
        velocities = ca.vertcat(s.xi, s.mu)
        self.sees_momentum = any(ca.depends_on(column, velocities) for column in columns)
        self.has_potential = not potential.is_zero()
        self.potential_function = _function("potential", [s.x, p], [potential])
        self._potential = Numeric(self.potential_function)
        total = ca.vertcat(torque, wrench)
        depends = ca.which_depends(ca.vertcat(total, potential), s.x, 1) if m else []
        touching = (
            {system.space.rates_of(k) for k in range(system.nx) if depends[k]} if m else set()
        )
        self.touched = terms.acted | set(self.joints) | {k for rates in touching for k in rates}
        self.sees_attitude, self.sees_place = seen_of_base(system, total, terms.base)
        self.sees_base_momenta = ca.depends_on(total, ca.vertcat(*terms.base[2:]))
        timed = self.sees_place or ca.depends_on(total, s.t)
        self.needs_time = bool(self.joints) or timed
        text = self.acting_function.serialize() + self.prescribed_function.serialize()
        self.key = hashlib.sha256(f"{self.joints}{text}".encode()).hexdigest()

    def _separate_switches(
        self, terms: ForceExpressions, numbers: ForceNumbers, within: ca.SX | None
    ) -> None:
        """Evaluate conditions on time at `within`, and prepare the search for their times.

        Args:
            terms: The terms, whose torques, wrenches and prescribed motions are changed.
            numbers: Numbers of the forces; `within` is added unless tables have it.
            within: Symbol of the time that selects the segments of tables, or None.
        """
        self._state_kinks: bool | None = None
        held_numbers = {k for _, where in terms.held for k in range(where.start, where.stop)}
        held_numbers |= {self.within.start} if within is not None else set()
        constant = [symbol for k, symbol in enumerate(numbers.symbols) if k not in held_numbers]
        t, symbol = terms.symbols.t, ca.SX.sym("within") if within is None else within
        separated = separate([terms.torques, terms.wrenches, *terms.motion], t, symbol, constant)
        if separated is None:
            self.switching = SwitchTimes([], t, symbol, numbers.symbols, self.tables)
            return
        if within is None:
            self.within = slice(len(numbers), len(numbers) + 1)
            numbers.add(symbol, 0.0)
        terms.torques, terms.wrenches, *motion = separated.expressions
        terms.motion = motion[0], motion[1], motion[2]
        self._state_kinks = separated.has_kinks
        self.switching = SwitchTimes(separated.switches, t, symbol, numbers.symbols, self.tables)

    def on(self, system: System) -> ForceModel:
        """Return this model for other parameters of the robot; compiled functions are shared."""
        return self._changed(("_once", "robot"), _system=system)

    def with_values(self, values: Mapping[str, Any]) -> ForceModel:
        """Return this model with new Parameter values {name: value}; functions are shared."""
        changes = np.array(
            [value_in(values, parameter) for parameter in self.parameters], dtype=float
        )
        changes -= [parameter.value for parameter in self.parameters]
        if not changes.any():
            return self
        return self._changed(("_once",), numbers=read_only(self.numbers + self.slopes @ changes))

    def with_tables(self, signals: Sequence[Signal], references: Sequence[Signal]) -> ForceModel:
        """Return this model with other tables of the same kinds; compiled functions are shared.

        Args:
            signals: Signals in the motions of the prescribed joints, in the order of `signals`.
            references: Signals in the forces, in the order of `references`.
        """
        tables = Tables(_tables_among((*signals, *references)))
        # The functions of time are shared, too.
        switching, _ = self.switching.with_tables(tables), self.time_functions
        other = self._changed(
            ("_once",), signals=tuple(signals), references=tuple(references), tables=tables,
            switching=switching, numbers=self.numbers.copy(),
        )  # fmt: skip
        other.set_span(other.numbers, 0.0)
        read_only(other.numbers)
        return other

    def _changed(self, cached: tuple[str, ...], **changes: Any) -> ForceModel:
        """Return a copy with changed attributes and without the cached properties `cached`."""
        other = copy(self)
        for name in cached:
            vars(other).pop(name, None)
        vars(other).update(changes)
        return other

    @cached_property
    def robot(self) -> Array:
        """Robot parameters in the expressions, (freed.size + 3,): of `freed`, then gravity."""
        return numbers_of(self._system, self.freed, weighed=self.weighed)

    @property
    def has_wrench(self) -> bool:
        """Whether a force acts on the base."""
        return bool(self.acting_on_base)

    @property
    def sees_base(self) -> bool:
        """Whether a force or a controller depends on pose or motion of the base in space."""
        controllers = (controller for controller, _ in self.held)
        return self.sees_attitude or self.sees_place or any(c.sees_base for c in controllers)

    def acting(self, at: ForceInputs) -> Acting:
        """Return the total torque and wrench at one state, or at T states.

        Raises:
            InputError: The forces depend on the base, and at.base is None.
        """
        torque, wrench = self._evaluate(self._acting, at)
        return Acting(torque[..., 0], wrench[..., 0])

    def acting_apart(self, at: ForceInputs) -> tuple[Array, Array, Array]:
        """Return torque and wrench without loads on links, and these loads, (9, L).

        Conditions on time are evaluated at the time itself, not at `within`.
        The loads are not mapped to the coordinates. A caller can therefore map them with an
        independent implementation.

        Args:
            at: State and numbers.
        Returns:
            Torque (m,) and wrench (r,), and a column for each load: six entries, and the point at
            which it acts, (3,) [m].
        Raises:
            InputError: The forces depend on the base, and at.base is None.
        """
        torque, wrench, loads = self._apart(*self._arguments(at))
        return torque[:, 0], wrench[:, 0], loads

    def required(self, at: ForceInputs) -> list[tuple[Array, Array]]:
        """Return accelerations (m,) that forces request, with the torques from inverse dynamics.

        Raises:
            InputError: The forces depend on the base, and at.base is None.
        """
        if self._required is None:
            return []
        accelerations, torques = self._required(*self._arguments(at))
        return list(zip(accelerations.T, torques.T, strict=True))

    def powers(self, at: ForceInputs, twist: Array) -> Array:
        """Return the power of each force that does work.

        Args:
            at: State and numbers, or T of them.
            twist: Body twist of the base itself, not relative to the centre of mass, (..., r).
        Returns:
            Powers, (..., len(labels)) [W].
        Raises:
            InputError: The forces depend on the base, and at.base is None.
        """
        torques, wrenches = self._evaluate(self._each, at)
        of_torques = np.einsum("...mk,...m->...k", torques, at.xdot)
        return np.asarray(of_torques + np.einsum("...rk,...r->...k", wrenches, twist))

    def _evaluate(self, function: Numeric, at: ForceInputs) -> list[Array]:
        """Return the results of a compiled function, (..., rows, columns) each."""
        t, *arguments = self._arguments(at)
        if isinstance(t, np.ndarray):
            return function.at_all(t[:, None], *arguments)
        return function(t, *arguments)

    def _arguments(self, at: ForceInputs) -> tuple[Any, ...]:
        """Return the arguments of the compiled functions."""
        if at.base is not None:
            base: tuple[Array, ...] = (at.base.pose, at.base.xi, at.base.mu, at.base.J)
        elif self.sees_attitude or self.sees_place:
            raise InputError(
                "these forces depend on the base; pass base= with its pose and momenta"
            )
        else:
            base = self._unseen
        return at.t, at.x, at.xdot, at.xi, at.mu, at.numbers, *base, self.robot

    def prescribed(self, t: float | Array, numbers: Array) -> Prescribed:
        """Return the motion of the prescribed joints at a time, or at times (T,).

        Args:
            t: Time, or times (T,) [s].
            numbers: Force parameters, (p,), or (T, p) at T times.
        Returns:
            The motion.
        """
        if isinstance(t, np.ndarray):
            values = self._prescribed.at_all(t[:, None], numbers)
        else:
            values = self._prescribed(t, numbers)
        return Prescribed(*(value[..., 0] for value in values))

    @cached_property
    def has_kinks(self) -> bool:
        """Whether forces are only piecewise smooth because of limits, signs or conditions.

        Conditions on time do not count: integration stops where they change.
        """
        if self._state_kinks is not None:
            return self._state_kinks
        functions = (self.acting_function, self.prescribed_function)
        return any(
            f.instruction_id(k) in KINKS for f in functions for k in range(f.n_instructions())
        )

    @property
    def time_functions(self) -> TimeFunctions:
        """The functions of time in the forces, shared by models with other numbers."""

        def make() -> TimeFunctions:
            functions = [(self.acting_function, 5), (self.prescribed_function, 1)]
            held_numbers = {k for _, where in self.held for k in range(where.start, where.stop)}
            return TimeFunctions(functions, len(self.numbers), held_numbers)

        return once(self.switching, TimeFunctions, make)

    def breaks(self, end: float) -> Array:
        """Return the sorted times before `end` at which a function of time is not smooth [s]."""
        return self.switching.breaks(end, self.numbers)

    def numbers_from(self, t: float, end: float) -> Array:
        """Return the numbers (p,) for the segment of time that starts at t, with zero commands."""
        numbers = self.numbers.copy()
        breaks = self.breaks(end)
        later = breaks[breaks > t]
        self.set_span(numbers, time_within(t, float(later[0]) if later.size else end))
        return numbers

    def set_span(self, numbers: Array, within: Any) -> None:
        """Write the numbers that change from span to span into numbers of one run or several runs.

        Args:
            numbers: Numbers, (…, p), changed in place.
            within: A time in the span of each row, (…) [s].
        """
        width = self.within.stop - self.within.start
        numbers[..., self.within] = self.tables.at(within)[..., :width]

    def random_numbers(self, rng: np.random.Generator, time: float = 0.0) -> Array:
        """Return random force parameters, (p,), for tests of kernels at a time [s]."""
        values = self.numbers.copy()
        self.set_span(values, time)
        numbers = random_numbers(values, self._in_formulas, rng)
        if self.tables.signals:  # a segment is undefined far from its start
            starts = self.tables.starts
            numbers[starts] = values[starts]
        return numbers

    def potential(self, x: Array, numbers: Array) -> Array:
        """Return V(x) of the forces that have a potential, (...) [J], at x, (nx,) or (T, nx)."""
        batch = x.ndim == 2
        (values,) = self._potential.at_all(x, numbers) if batch else self._potential(x, numbers)
        return values[..., 0, 0]


def _tables_among(signals: Sequence[Signal]) -> list[Table]:
    """Return the distinct tables among signals, in the order of first use."""
    return list(dict.fromkeys(signal for signal in signals if isinstance(signal, Table)))


def _function(name: str, inputs: list[ca.SX], outputs: list[ca.SX]) -> ca.Function:
    dense = [ca.densify(value) for value in outputs]
    return ca.Function(name, inputs, dense, {"cse": True})


def touched_by(forces: ForceModel | None) -> frozenset[int]:
    """Return the joints that forces act on or depend on."""
    return frozenset() if forces is None else frozenset(forces.touched)


def of_load(
    system: System, robot: RobotSymbols, s: Symbols, load: Load, what: str
) -> tuple[ca.SX, ca.SX]:
    """Express a load by torques and a wrench on the base.

    Args:
        system: The robot.
        robot: Symbols of the robot parameters.
        s: Variables of the forces.
        load: Wrench on a link, or along fixed axes.
        what: Name of the force in messages.
    Returns:
        Torques on the shape, (m,), and wrench on the base, (r,).
    """
    if load.link is None:
        column = ca.vertcat(*_base_wrench(system, s, load.entries))
        return ca.SX(system.m, 1), ca.SX(column)
    index = link_frame(system, load.link, what)
    r, m = system.r, system.m
    xi, xdot = ca.SX.sym("xi", r), ca.SX.sym("xdot", m)
    force, moment = load.entries[:3], load.entries[3:]
    if load.frame == "world":
        force, moment = (_into_root(system, s.seen.pose, velocity) for velocity in (force, moment))
    bodies = robot.bodies
    joints = joint_values(system, ca.vertsplit(s.x) if m else [])
    rates = joint_rates(system, ca.vertsplit(xdot) if m else [])
    chain, i = [], system.sorted_model.frames[index].parentJoint - 1
    while i > 0:
        chain.append(i)
        i = bodies[i].parent
    v, w = _on_axes(system, ca.vertsplit(xi))
    for i in reversed(chain):
        step = step_of(bodies[i], joints)
        v, w = moved_twist(bodies[i], *step.outward(v, w), rates)
        if load.frame == "world":
            force, moment = (_undo_turns(step.turns, vector) for vector in (force, moment))
    turn, origin = robot.place(index)
    point = plus(origin, [dot(axis, load.at) for axis in turn])
    v = plus(v, cross(w, point))
    if load.frame == "body":
        force, moment = ([dot(axis, vector) for axis in turn] for vector in (force, moment))
    power = ca.SX(add(dot(force, v), dot(moment, w)))
    torque, wrench = (ca.SX(ca.gradient(power, v)) if v.numel() else v for v in (xdot, xi))
    return torque, wrench


def _base_wrench(system: System, s: Symbols, entries: list[Scalar]) -> list[Scalar]:
    """Convert a wrench (r,) on the base from the fixed axes to the base's axes."""
    lin, ang = _on_axes(system, entries)
    rotated = [*_rotate_back(system, s.seen.pose, lin), *_rotate_back(system, s.seen.pose, ang)]
    return [rotated[axis] for axis in system.group.axes]


def _on_axes(system: System, entries: list[Scalar]) -> tuple[Vec, Vec]:
    """Return a twist or wrench of the group, (r,), as a spatial vector in the root body's frame."""
    spatial: Vec = [0.0] * 6
    for axis, entry in zip(system.group.axes, entries, strict=True):
        spatial[axis] = entry
    return spatial[:3], spatial[3:]


def _into_root(system: System, pose: ca.SX, v: Vec) -> Vec:
    """Convert a vector from the root joint's fixed frame to the root body's frame in the sweep."""
    root_axes = bodies_of(system)[0].frame.rotation.T.tolist()
    return _rotate_back(system, pose, [dot(axis, v) for axis in root_axes])


def _rotate_back(system: System, pose: ca.SX, v: Vec) -> Vec:
    """Return Rᵀ v for the attitude R of a pose; its quaternion must have length one."""
    group = system.group
    if group.turns == 0:
        return list(v)
    if group.turns == 1:
        angle = pose[group.size - 1]
        return Turn(group.axes[-1] - 3, ca.cos(angle), ca.sin(angle)).back(v)
    x, y, z, w = (pose[group.linear + k] for k in range(4))
    u = [-x, -y, -z]
    t = cross(u, v)
    second_cross = cross(u, t)
    return [add(v[i], mul(2.0, add(mul(w, t[i]), second_cross[i]))) for i in range(3)]


def _undo_turns(turns: Sequence[Turn | Rotation], v: Vec) -> Vec:
    for turn in turns:
        if not turn.is_none:
            v = turn.back(v)
    return v


def required_torque(system: System, robot: RobotSymbols, s: Symbols, accelerations: ca.SX) -> ca.SX:
    """Return the torques that produce requested joint accelerations while the base moves freely.

    The momenta are (μ, π) = H v with v = (ξ, ẋ). The base acceleration follows from μ̇ = ad*_ξ μ,
    and then τ = dπ/dt − e_α T + e_α V − π × σ, where the last term belongs to balls with the
    angular velocity σ. Gravity must have no moment on the base.

    Args:
        system: The robot.
        robot: Symbols of the robot parameters.
        s: Variables of the forces.
        accelerations: Joint accelerations, (m,) [rad/s² | m/s²].
    Returns:
        Torques, (m,) [N·m | N].
    """
    r, gravity = system.r, robot.gravity
    momenta_of = partial(momenta, system, s.x, bodies=robot.bodies)
    v = ca.vertcat(s.xi, s.xdot)
    p = momenta_of(v)
    transport = ca.jtimes(p, s.x, rate_map(system, s.x) @ s.xdot)  # Ḣ v
    mu, eta = p[:r], ca.SX.sym("eta", r)
    coadjoint = ca.gradient(ca.dot(mu, bracket(system.group, s.xi, eta)), eta)  # ad*_ξ μ
    from_accelerations = momenta_of(ca.vertcat(ca.SX(r, 1), accelerations))
    I = ca.jacobian(mu, s.xi)
    xidot = solve_spd(I, coadjoint - transport[:r] - from_accelerations[:r])
    pidot = momenta_of(ca.vertcat(xidot, accelerations))[r:] + transport[r:]
    torque = pidot - shape_gradient(system, 0.5 * ca.dot(v, p), s.x)
    for ball in system.space.balls:
        sigma, pi = s.xdot[ball.v], p[r:][ball.v]
        torque[ball.v] -= ca.cross(pi, sigma)
    if not system.group.is_pivot:  # a pivot is at the centre of mass, so gravity has no potential
        com = centre_of_mass(robot.bodies, joint_values(system, ca.vertsplit(s.x)))
        work = robot.mass * dot(gravity, com)
        torque -= shape_gradient(system, ca.SX(work), s.x)
    return torque


def loop_motion(system: System, s: Symbols, independent: Sequence[int]) -> tuple[ca.SX, ca.SX]:
    """Return G and d with ẋ = G u̇ and ẍ = G ü + d for the rates u̇ of independent joints.

    J ẋ = 0 determines the rates of the dependent joints D, −J_D⁻¹ J_I u̇.  J ẍ + J̇ ẋ = 0
    determines their drift, d_D = −J_D⁻¹ J̇ ẋ.

    Args:
        system: The robot, with loops.
        s: Variables of the forces.
        independent: Indices of the independent rates, as many as `shape_dim`.
    Returns:
        G, (m, k), and d, (m,).
    Raises:
        InputError: The number of independent joints is wrong.
    """
    assert system.closure is not None
    if len(independent) != system.shape_dim:
        names = listed([loop.name for loop in system.loops], 6)
        raise InputError(
            f"computed torque: expected references and plans for {system.shape_dim} joints, which "
            f"determine the others by the loops {names}, got {len(independent)}"
        )
    dependent = np.setdiff1d(np.arange(system.m), independent).tolist()
    rate = ca.SX.sym("rate", system.m)
    J = jacobian_function(system)(s.x)
    turning = ca.jtimes(J @ rate, s.x, rate_map(system, s.x) @ s.xdot)
    turning = ca.substitute(turning, rate, s.xdot)
    G, drift = ca.SX(system.m, len(independent)), ca.SX(system.m, 1)
    G[list(independent), :] = ca.SX.eye(len(independent))
    # The QR factorisation of ca.solve loses digits where equations have different units.
    units = equation_weights(system, system.closure.length)[system.closure.rows]
    scaled = ca.diag(ca.DM(units)) @ ca.horzcat(J, turning)
    solved = ca.solve(scaled[:, dependent], scaled[:, [*independent, system.m]])
    G[dependent, :], drift[dependent] = -solved[:, :-1], -solved[:, -1]
    return G, drift
