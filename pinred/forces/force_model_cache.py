"""A cache of force models, shared by scenes that differ only in numbers."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import Any

from ..common.errors import InputError
from ..common.memo import recent
from ..common.names import brief
from ..common.parameter import Parameter, parameters_in, values_of
from ..reduction.potential import spring_pair
from ..reduction.tree.free_bodies import NOTHING, freed_of
from ..system.model_parameters import ModelParameters
from ..system.system import System
from ..system.variants import nominal
from .force import Force
from .force_keys import NotKeyedError, key_of, key_of_force
from .force_model import ForceModel
from .kinds import Spring
from .prescribed_joints import Plan, signals_of
from .signals import Attitude, Constant, Expression, Signal
from .signals.tabulated import Table

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
    owner, freed, links = system, NOTHING, tuple[int, ...]()
    if varied is not None:
        owner, links = nominal(system), varied.links
        freed = freed_of(owner, varied.free, varied.placed, varied.turned, generic=True)
    # Cache by value; objects without value equality are keyed by identity and kept alive.
    sprung = [_spring(name, pair) for name, pair in springs.items()]
    everything = _all_forces(sprung, forces, prescribed)
    key = (
        tuple(sprung),
        *map(_key_of_force, forces),
        *((name, _key_of(signal)) for name, signal in prescribed.items()),
        freed,
        links,
    )

    def build() -> ForceModel:
        return ForceModel(owner, everything, prescribed, freed, links)

    def make() -> tuple[ForceModel, object]:
        tables: dict[Table, Hashable] = {}
        kinds = (
            tuple(sprung),
            *(_kind_of_force(force, tables) for force in forces),
            *((name, _kind_of(signal, tables)) for name, signal in prescribed.items()),
            freed,
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
    stiffness, rest = spring_pair(name, numbers).tolist()
    for k, parameter in parameters_in(pair):
        stiffness, rest = (parameter, rest) if k == 0 else (stiffness, parameter)
    return Spring(name, stiffness, rest)


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
