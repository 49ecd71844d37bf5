"""All forces of a scene and its prescribed joints: one set of expressions, and their numbers."""

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
from ..common.casadi_calls import Numeric
from ..common.errors import InputError
from ..common.parameter import Affine, Parameter, parameter_of
from ..reduction.tree.free_bodies import NOTHING, Freed
from ..system.force_interface import Load
from ..system.system import System
from .acting import Acting, BaseInSpace, Prescribed
from .columns import load_column, seen_of_base, symbols_of, through, torque_column, wrench_column
from .force import Force, Symbols, Terms
from .kinds import Controller
from .link_loads import of_load
from .robot_symbols import RobotSymbols, numbers_of
from .signals import Signal
from .written import terms_of

_NEAR = 1e-2  # relative
_KINKS = {
    ca.OP_FABS, ca.OP_SIGN, ca.OP_COPYSIGN, ca.OP_FMIN, ca.OP_FMAX, ca.OP_IF_ELSE_ZERO,
    ca.OP_FLOOR, ca.OP_CEIL, ca.OP_FMOD, ca.OP_REMAINDER,
    ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_NOT, ca.OP_AND, ca.OP_OR,
}  # fmt: skip


class ForceModel:
    """The forces and prescribed joints of a scene.

    numbers: (p,) the values in them that may change without another kernel.  parameters: those in
    them, and slopes, (p, parameters), ∂numbers/∂parameters, which are constants.  held:
    controllers, each with the place among the numbers of the torques that it holds.  key: a
    digest of the expressions.  within: the place among the numbers of the time that says which
    piece of a table counts.  joints: indices of the prescribed joints; signals: their motions;
    references: the functions of time in the forces.  touched: joints that something acts on,
    or whose position something depends on.  labels: of the forces that do work.
    acting_on_base: labels of those that act on the base itself: its momentum is integrated.
    sees_momentum: whether forces depend on twist or momentum of the base as Symbols have them.
    sees_attitude, sees_place: whether forces depend on the base's attitude, and on where its centre
    of mass is or how fast it moves.  sees_base_momenta: whether on its momenta in space.
    loads: link and axes of each wrench that acts elsewhere.
    freed: numbers of the robot that the expressions take, links among them; weighed: whether
    gravity counts in them, as in inverse dynamics.
    acting_function: (t, x, ẋ, ξ, μ, numbers, pose, twist, μ and J of the base in space, numbers of
    the robot) → (torque, wrench).  prescribed_function:
    (t, numbers) → (x, ẋ, ẍ) of the prescribed joints.  potential_function: (x, numbers) → V, zero
    if not has_potential.
    """

    def __init__(
        self,
        system: System,
        forces: Sequence[Force],
        prescribed: Mapping[str, Signal],
        freed: Freed = NOTHING,
        movable: Collection[int] = (),
    ) -> None:
        """Write all forces down.  Raises InputError for joints that are not there.

        freed: numbers of the robot that may vary.  movable: links whose places may, as frames.
        """
        m, r = system.m, system.r
        self._system, robot = system, RobotSymbols(system, freed, movable)
        inverse: list[tuple[ca.SX, ca.SX]] = []  # accelerations, and torques for them
        self._unseen = (np.zeros(system.group.size), *np.zeros((3, r)))
        self._values: list[float] = []
        self._names: list[ca.SX] = []
        self._slopes: list[tuple[int, Parameter, float]] = []
        self._slot_of: dict[Parameter, int] = {}
        self._in_formulas: list[int] = []
        self.signals = tuple(prescribed.values())
        self.references = tuple(signal for force in forces for signal in force.signals)
        has_breaks = any(signal.breaks.size for signal in (*self.signals, *self.references))
        within = self._number(0.0) if has_breaks else None
        s, base = symbols_of(system, within)
        self.within = slice(0, int(has_breaks))
        for name in prescribed:
            system.refuse_follower(name, "prescribed")
        self.joints = tuple(s.joint(name, "prescribed") for name in prescribed)
        for name, signal in prescribed.items():
            if signal.smoothness < 1:
                raise InputError(
                    f"prescribed['{name}'] must have a continuous rate, but {signal!r} has a kink "
                    "or a jump; use a Spline"
                )
        x = ca.vertcat(*(each.written(s.t, s.within, self._number) for each in self.signals))
        xdot = ca.jacobian(x, s.t)
        xddot = ca.jacobian(xdot, s.t)
        self.held: list[tuple[Controller, slice]] = []
        self.labels: list[str] = []
        potential, torques, wrenches = ca.SX(0), ca.SX(m, 0), ca.SX(r, 0)
        direct: list[ca.SX] = []
        loads: list[Load] = []
        self.acting_on_base: list[str] = []
        acted: set[int] = set()
        for force in sorted(forces, key=lambda force: force.last):
            if force.last:
                if sum(other.last for other in forces) > 1:
                    raise InputError(f"{force.label}: only one force may know all the others")
                others = ca.sum2(torques) - ca.gradient(potential, s.x)
                known = dict(zip(self.joints, ca.vertsplit(xddot), strict=True))
                required = partial(_required_torque, system, robot, s, inverse)
                s = replace(s, others=others, accelerations=known, required_torque=required)
            first = len(self._values)
            terms = terms_of(force, s, self._number)
            self._check_symbols(s, robot, terms, force.label)
            if isinstance(force, Controller):
                held = force.count(s.names, r)
                self.held.append((force, slice(first, first + held)))
            if terms.potential is not None:
                potential = potential + terms.potential
            if terms.torque or terms.wrench is not None or terms.loads:
                self.labels.append(force.label)
                torque, wrench = torque_column(terms, system), wrench_column(terms, r)
                direct += [ca.vertcat(torque, wrench)]
                for load in terms.loads:
                    also = of_load(system, robot, s, load, force.label)
                    torque, wrench = torque + also.torque, wrench + also.wrench
                    acted |= {k for k in range(m) if not also.torque[k].is_zero()}
                loads += terms.loads
                torques, wrenches = ca.horzcat(torques, torque), ca.horzcat(wrenches, wrench)
                if terms.wrench is not None or terms.loads:
                    self.acting_on_base.append(force.label)
                acted |= {through(system, k)[0] for k in terms.torque}
        self.numbers = read_only(np.array(self._values))
        self.parameters = self._checked_parameters()
        self.slopes = np.zeros((len(self.numbers), len(self.parameters)))
        for slot, parameter, slope in self._slopes:
            self.slopes[slot, self.parameters.index(parameter)] = slope
        p = ca.vertcat(*self._names)
        self.freed, self.weighed = robot.freed, robot.weighed
        state = [s.t, s.x, s.xdot, s.xi, s.mu, p, *base, robot.column]
        forward: ca.SX = -ca.gradient(potential, s.x)
        torque, wrench = ca.sum2(torques) + forward, ca.sum2(wrenches)
        self.prescribed_function = _function("prescribed", [s.t, p], [x, xdot, xddot])
        self.acting_function = _function("acting", state, [torque, wrench])
        self._acting = Numeric(self.acting_function)
        self._prescribed = Numeric(self.prescribed_function)
        self._each = Numeric(_function("each", state, [torques, wrenches]))
        pairs = [ca.horzcat(ca.SX(m, 0), *columns) for columns in zip(*inverse, strict=True)]
        self._required = Numeric(_function("required", state, pairs)) if pairs else None
        self.loads = tuple((load.link, load.frame) for load in loads)
        alone = ca.sum2(ca.horzcat(ca.SX(m + r, 0), *direct)) + ca.vertcat(forward, ca.SX(r, 1))
        columns = ca.vertsplit(alone, [0, m, m + r])  # alone[:0] is no column
        columns.append(ca.horzcat(ca.SX(9, 0), *map(load_column, loads)))
        self._apart = Numeric(_function("apart", state, columns))
        moves = ca.vertcat(s.xi, s.mu)
        self.sees_momentum = any(ca.depends_on(column, moves) for column in columns)
        self.has_potential = not potential.is_zero()
        self.potential_function = _function("potential", [s.x, p], [potential])
        self._potential = Numeric(self.potential_function)
        everything = ca.vertcat(torque, wrench)
        depends = ca.which_depends(ca.vertcat(everything, potential), s.x, 1) if m else []
        self.touched = acted | set(self.joints) | {k for k in range(m) if depends[k]}
        self.sees_attitude, self.sees_place = seen_of_base(system, everything, base)
        self.sees_base_momenta = ca.depends_on(everything, ca.vertcat(*base[2:]))
        timed = self.sees_place or ca.depends_on(everything, s.t)
        self.needs_time = bool(self.joints) or timed
        text = self.acting_function.serialize() + self.prescribed_function.serialize()
        self.key = hashlib.sha256(f"{self.joints}{text}".encode()).hexdigest()

    def on(self, system: System) -> ForceModel:
        """Return this model on the same robot with other numbers; it shares the rest."""
        other = copy(self)
        for name in ("_once", "robot"):  # what was made for these numbers
            vars(other).pop(name, None)
        other._system = system
        return other

    @cached_property
    def robot(self) -> Array:
        """The robot's numbers in the expressions, (freed.size + 3,): of `freed`, then gravity."""
        return numbers_of(self._system, self.freed, weighed=self.weighed)

    def with_values(self, values: Mapping[str, Any]) -> ForceModel:
        """Return this model with other values of parameters, {name: value}; it shares the rest."""
        moved = np.array([values.get(each.name, each.value) for each in self.parameters])
        moved -= [each.value for each in self.parameters]
        if not moved.any():
            return self
        other = copy(self)
        vars(other).pop("_once", None)  # what was made for these numbers
        other.numbers = read_only(self.numbers + self.slopes @ moved)
        return other

    @property
    def has_wrench(self) -> bool:
        """Whether something acts on the base itself."""
        return bool(self.acting_on_base)

    @property
    def sees_base(self) -> bool:
        """Whether a force, or a controller, sees where the base is or how it moves in space."""
        controllers = (controller for controller, _ in self.held)
        return self.sees_attitude or self.sees_place or any(c.sees_base for c in controllers)

    def acting(
        self,
        t: float,
        x: Array,
        xdot: Array,
        xi: Array,
        mu: Array,
        numbers: Array,
        base: BaseInSpace | None = None,
    ) -> Acting:
        """Return all that acts at one state; arguments as in Symbols, numbers (p,).

        base: what forces see of it besides, None if they do not.
        """
        seen = self._of_base(base)
        torque, wrench = self._acting(t, x, xdot, xi, mu, numbers, *seen, self.robot)
        return Acting(torque[:, 0], wrench[:, 0])

    def acting_apart(
        self,
        t: float,
        x: Array,
        xdot: Array,
        xi: Array,
        mu: Array,
        numbers: Array,
        base: BaseInSpace | None,
    ) -> tuple[Acting, Array]:
        """Return what acts but for the loads, and these, (9, L): entries (6,) and point (3,).

        They are not moved to the coordinates: for who does that by other means.
        """
        seen = self._of_base(base)
        torque, wrench, loads = self._apart(t, x, xdot, xi, mu, numbers, *seen, self.robot)
        return Acting(torque[:, 0], wrench[:, 0]), loads

    def required(
        self,
        t: float,
        x: Array,
        xdot: Array,
        xi: Array,
        mu: Array,
        numbers: Array,
        base: BaseInSpace | None,
    ) -> list[tuple[Array, Array]]:
        """Return accelerations (m,) that forces want of the joints, and the torques for them.

        By their inverse dynamics, for who knows these by other means.
        """
        if self._required is None:
            return []
        seen = self._of_base(base)
        wanted, torques = self._required(t, x, xdot, xi, mu, numbers, *seen, self.robot)
        return list(zip(wanted.T, torques.T, strict=True))

    def _of_base(self, base: BaseInSpace | None) -> tuple[Array, ...]:
        if base is not None:
            return base.pose, base.xi, base.mu, base.J
        if self.sees_attitude or self.sees_place:
            raise InputError("these forces see the base; give base= with its pose and momenta")
        return self._unseen

    def prescribed(self, t: float, numbers: Array) -> Prescribed:
        """Return the motion of the prescribed joints at a time."""
        return Prescribed(*(value[:, 0] for value in self._prescribed(t, numbers)))

    @cached_property
    def has_kinks(self) -> bool:
        """Whether anything that acts is made of pieces: limits, signs, conditions."""
        functions = (self.acting_function, self.prescribed_function)
        return any(
            f.instruction_id(k) in _KINKS for f in functions for k in range(f.n_instructions())
        )

    def breaks(self, end: float) -> Array:
        """Return the times before `end` at which a function of time is not smooth, sorted [s]."""
        times = [signal.breaks for signal in (*self.signals, *self.references)]
        every = np.unique(np.concatenate(times)) if times else np.empty(0)
        return np.asarray(every[(every > 0.0) & (every < end)])

    def numbers_from(self, t: float, end: float) -> Array:
        """Return the numbers for the stretch that begins at t, where controllers hold nothing."""
        numbers = self.numbers.copy()
        later = [*(stop for stop in self.breaks(end).tolist() if stop > t), end]
        numbers[self.within] = 0.5 * (t + later[0])
        return numbers

    def random_numbers(self, rng: np.random.Generator) -> Array:
        """Return numbers (p,) with which kernels are tried: any, in formulas near their own."""
        numbers = rng.normal(size=len(self.numbers))
        near = self._in_formulas
        numbers[near] = self.numbers[near] * (1.0 + _NEAR * numbers[near])
        return numbers

    def potential(self, x: Array, numbers: Array) -> float:
        """Return V(x) of the forces that have a potential [J]."""
        (value,) = self._potential(x, numbers)
        return float(value[0, 0])

    def powers(
        self,
        t: float,
        x: Array,
        xdot: Array,
        xi: Array,
        mu: Array,
        numbers: Array,
        twist: Array,
        base: BaseInSpace | None,
    ) -> Array:
        """Return the power of each force that does work, (len(labels),) [W].

        twist: (r,) the full body twist of the base, not that relative to the centre of mass.
        """
        seen = self._of_base(base)
        torques, wrenches = self._each(t, x, xdot, xi, mu, numbers, *seen, self.robot)
        return np.asarray(torques.T @ xdot + wrenches.T @ twist)

    def _check_symbols(self, s: Symbols, robot: RobotSymbols, terms: Terms, what: str) -> None:
        """Raise InputError if a force contains a symbol that it was not given."""
        seen = (s.seen.pose, s.seen.xi, s.seen.mu, s.seen.J)
        own = ca.vertcat(s.t, s.x, s.xdot, s.xi, s.mu, *seen, *self._names, robot.column)
        known = {symbol.element_hash() for symbol in ca.symvar(own)}
        for symbol in ca.symvar(ca.SX(ca.vertcat(*terms.expressions))):
            if symbol.element_hash() in known:
                continue
            parameter = parameter_of(symbol)
            if parameter is not None:
                self._number(parameter)
            else:
                raise InputError(
                    f"{what} has a symbol '{symbol}' that is none of t, x, xdot and mu; "
                    "use those that the function is given"
                )

    def _number(self, value: Any) -> ca.SX:
        """Return the symbol of a number, of a Parameter, or of what is Affine in some."""
        slot = len(self._values)
        if isinstance(value, Parameter):
            if value not in self._slot_of:
                self._slot_of[value] = slot
                self._slopes.append((slot, value, 1.0))
                self._values.append(value.value)
                self._names.append(value.symbol)
            return self._names[self._slot_of[value]]
        if isinstance(value, Affine):
            self._in_formulas.append(slot)
            self._slopes += [(slot, each, weight) for each, weight in value.weights.items()]
            value = value.value
        self._values.append(value)
        self._names.append(ca.SX.sym(f"p{slot}"))
        return self._names[-1]

    def _checked_parameters(self) -> tuple[Parameter, ...]:
        """Return the parameters in all that is written.  Raises InputError for two of one name."""
        found = list(dict.fromkeys(parameter for _, parameter, _ in self._slopes))
        names = [parameter.name for parameter in found]
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            raise InputError(
                f"two Parameters are called '{twice[0]}'; make one and use it in both places, or "
                "give them names of their own"
            )
        return tuple(found)


def _required_torque(
    system: System,
    robot: RobotSymbols,
    s: Symbols,
    required: list[tuple[ca.SX, ca.SX]],
    accelerations: Mapping[int, ca.SX],
) -> ca.SX:
    """Return the torques (m,) that give the joints accelerations, and keep both."""
    from .inverse_dynamics import required_torque  # heavy to import

    wanted = ca.vertcat(*(accelerations[k] for k in range(system.m)))
    required.append((wanted, required_torque(system, robot, s, wanted)))
    return required[-1][1]


def _function(name: str, inputs: list[ca.SX], outputs: list[ca.SX]) -> ca.Function:
    dense = [ca.densify(value) for value in outputs]
    return ca.Function(name, inputs, dense, {"cse": True})


def touched_by(forces: ForceModel | None) -> frozenset[int]:
    """Return the joints that forces act on or depend on."""
    return frozenset() if forces is None else frozenset(forces.touched)
