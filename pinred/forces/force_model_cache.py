"""A cache of force models, shared by scenes that differ only in numbers.

Keys of forces and of motions differ whenever a result may differ. Numbers, tables of numbers and
arrays are compared by value, because they can change in place.  They are compared with their types:
True and 1 are equal, but only one of them is a valid number. Functions, Parameters and signals
cannot change, so keys contain the objects themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from types import BuiltinFunctionType, FunctionType, MethodType
from typing import Any

import numpy as np

from ..common.argument_kinds import Default
from ..common.errors import InputError
from ..common.memo import recent
from ..common.names import brief
from ..common.parameter import Parameter, VectorParameter, parameters_in, values_of
from ..reduction.potential import spring_pair
from ..reduction.tree.free_bodies import NOTHING, freed_of
from ..system.model_parameters import ModelParameters
from ..system.system import System, nominal
from .controller import Actuation, Controller
from .force import Force, Limit
from .force_model import ForceModel
from .kinds import Damper, Friction, Spring
from .signals import Attitude, Constant, Expression, Signal
from .signals.signal import Table
from .tracking import Plan, signals_of

_PACKAGE = f"{__name__.partition('.')[0]}."
PLAIN = frozenset({float, int, Default, np.float64, np.int64, str, bool, type(None)})
_FUNCTIONS = (FunctionType, MethodType, BuiltinFunctionType)


class NotKeyedError(Exception):
    """A value has no key, because it may change in place."""


def _key_of_array(array: np.ndarray) -> Hashable:
    """Return the key of an array of numbers; raise NotKeyedError for arrays of objects."""
    if array.dtype.hasobject:
        raise NotKeyedError
    return array.dtype.str, array.shape, array.tobytes()


def key_of(value: Any, of_table: Callable[[Table], Hashable] | None = None) -> Hashable:
    """Return the key of a value in a force or in the option `prescribed`.

    Args:
        value: Number, text, mapping, array, function, Parameter, signal, attitude or limit.
        of_table: Function that returns the key of a table; None to compare tables by identity.
            With this function, functions in the value have no key: they may use other variables.
    Returns:
        The key, which keeps the objects in it alive.
    Raises:
        NotKeyedError: The value may change in place.
    """
    kind = type(value)
    if kind in PLAIN:
        return kind, value
    if of_table is not None and isinstance(value, Table):
        return of_table(value)
    if kind in (Parameter, VectorParameter, Expression):
        return kind, value
    if isinstance(value, _FUNCTIONS) and of_table is None:
        return kind, value
    if kind is dict:
        return kind, tuple([(key_of(k), key_of(entry, of_table)) for k, entry in value.items()])
    if kind in (list, tuple):
        return kind, tuple([key_of(entry, of_table) for entry in value])
    if kind is np.ndarray:
        return _key_of_array(value)
    if kind in (Limit, Attitude):
        return kind, key_of(vars(value), of_table)
    if isinstance(value, Signal) and kind.__module__.startswith(_PACKAGE):
        return kind, _Same(value)
    raise NotKeyedError


def key_of_force(force: Force) -> Hashable:
    """Return the key of a force.

    Springs, dampers, friction and actuators are compared by value.  Other forces are compared by
    identity, because their functions may use variables that change, and by their numbers.

    Args:
        force: The force.
    Returns:
        The key, which keeps the force alive.
    Raises:
        NotKeyedError: The force may change in place, as a controller does.
    """
    kind = type(force)
    if kind in (Spring, Damper, Friction):
        return kind, force
    if isinstance(force, Actuation):
        return kind, tuple((actuator, key_of(control)) for actuator, control in force.controls)
    if kind is Controller or not kind.__module__.startswith(_PACKAGE):
        raise NotKeyedError
    return _Same(force), key_of(vars(force))


class _Same:
    """A key that is equal for the same object only, and keeps it alive."""

    __slots__ = ("_value",)

    def __init__(self, value: object) -> None:
        self._value = value

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and self._value is other._value

    def __hash__(self) -> int:
        return id(self._value)


_REMEMBERED = 16  # largest number of cached models per system


def cached_force_model(
    system: System,
    springs: Mapping[str, tuple[float | Parameter, float | Parameter]],
    forces: Sequence[Force],
    prescribed: Mapping[str, Plan],
    varied: ModelParameters | None = None,
) -> ForceModel:
    """Return the model of springs, forces and prescribed joints, from the cache if possible.

    The most recently used models of a system are cached. Scenes that differ only in their initial
    state or in variable robot parameters share them.

    Args:
        system: The robot.
        springs: Stiffness and rest position by joint, {joint: (stiffness, rest)}.
        forces: Forces and controllers.
        prescribed: Motions of joints by name.
        varied: Robot parameters that may vary, or None.
    Returns:
        The model.
    Raises:
        InputError: A force, a signal or a joint name is invalid.
    """
    owner, variable, links = system, NOTHING, tuple[int, ...]()
    if varied is not None:
        owner, links = nominal(system), varied.links
        variable = freed_of(owner, varied.free, varied.placed, varied.turned, generic=True)
    # Cache by value; objects without value equality are keyed by identity and kept alive.
    sprung = [_spring(name, pair) for name, pair in springs.items()]
    everything = _all_forces(sprung, forces, prescribed)
    key = (
        tuple(sprung),
        *map(_key_of_force, forces),
        *((name, _key_of(signal)) for name, signal in prescribed.items()),
        variable,
        links,
    )

    def build() -> ForceModel:
        return ForceModel(owner, everything, prescribed, variable, links)

    def make() -> tuple[ForceModel, object]:
        tables: dict[Table, Hashable] = {}
        kinds = (
            tuple(sprung),
            *(_kind_of_force(force, tables) for force in forces),
            *((name, _kind_of(signal, tables)) for name, signal in prescribed.items()),
            variable,
            links,
        )
        if not tables:
            return build(), (tuple(forces), dict(prescribed))
        kept = tuple(forces), dict(prescribed)
        first, _ = recent(
            owner, kinds, lambda: (build(), kept), _REMEMBERED, (cached_force_model, Table)
        )
        # Models that differ only in tables share all compiled functions.
        signals = [signal for plan in prescribed.values() for signal in signals_of(plan)]
        references = [signal for force in everything for signal in force.signals]
        if (*signals, *references) == (*first.signals, *first.references):
            return first, kept
        return first.with_tables(signals, references), kept

    model, _ = recent(owner, key, make, _REMEMBERED, cached_force_model)
    return model if system is owner else model.on(system)


def _kind_of_force(force: Force, tables: dict[Table, Hashable]) -> Hashable:
    """Return a key that is equal for forces that differ only in tables; see `_kind_of`."""
    if not any(isinstance(signal, Table) for signal in force.signals):
        return _key_of_force(force)
    try:
        key = type(force), key_of(vars(force), lambda table: _kind_of_table(table, tables))
        hash(key)
    except (NotKeyedError, TypeError):
        return id(force)
    return key


def _kind_of(plan: Plan, tables: dict[Table, Hashable]) -> Hashable:
    """Return a key that is equal for motions that differ only in tables.

    Args:
        plan: The motion.
        tables: The tables seen so far, each with its key; tables of this motion are added.
    """
    if isinstance(plan, Attitude):
        return tuple(_kind_of(part, tables) for part in plan.vector), tuple(plan.centre)
    return _kind_of_table(plan, tables) if isinstance(plan, Table) else _key_of(plan)


def _kind_of_table(table: Table, tables: dict[Table, Hashable]) -> Hashable:
    """Return the key of a table: its index among all tables, its type and its Parameters."""
    return tables.setdefault(table, (len(tables), type(table), table.parameters))


def _key_of_force(force: Force) -> Hashable:
    """Return the key of a force; its identity if it may change in place."""
    try:
        key = key_of_force(force)
        hash(key)
    except (NotKeyedError, TypeError):
        return id(force)
    return key


def _key_of(signal: Plan) -> Hashable:
    """Return a key that is equal for signals that define the same function of time."""
    if isinstance(signal, Attitude):
        return tuple(_key_of(component) for component in signal.vector), tuple(signal.centre)
    simple = isinstance(signal, Expression) or (
        isinstance(signal, Constant) and not isinstance(vars(signal)["_given"], Parameter)
    )
    return signal if simple else id(signal)


def _spring(name: str, pair: Any) -> Spring:
    """Return the spring with (stiffness, rest position); each may be a Parameter."""
    numbers = values_of(list(pair) if isinstance(pair, (list, tuple)) else pair)
    stiffness, rest_angle = spring_pair(name, numbers).tolist()
    for k, parameter in parameters_in(pair):
        stiffness, rest_angle = (parameter, rest_angle) if k == 0 else (stiffness, parameter)
    return Spring(name, stiffness, rest_angle)


def _all_forces(
    springs: Sequence[Force], forces: Sequence[Force], prescribed: Mapping[str, Plan]
) -> list[Force]:
    """Return springs and forces in one list.

    Args:
        springs: Springs.
        forces: Further forces.
        prescribed: Motions of joints by name.
    Returns:
        All forces.
    Raises:
        InputError: An entry is not a Force or not a Signal.
    """
    checked = list(springs)
    for force in forces:
        if not isinstance(force, Force):
            raise InputError(f"forces: expected objects of pinred.forces, got {brief(force)}")
        checked.append(force)
    for name, signal in prescribed.items():
        if not isinstance(signal, (Signal, Attitude)):
            raise InputError(f"prescribed['{name}'] must be a Signal or Attitude, got {signal!r}")
    return checked
