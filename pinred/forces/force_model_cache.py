"""Force models that are kept, for scenes that differ in numbers only."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import Any

from ..common.errors import InputError
from ..common.memo import once
from ..common.parameter import Parameter, parameters_in, values_of
from ..common.plain_names import brief
from ..reduction.potential import spring_pair
from ..reduction.tree.free_bodies import NOTHING, freed_of
from ..system.model_parameters import ModelParameters
from ..system.system import System
from ..system.variants import nominal
from .force import Force
from .force_model import ForceModel
from .kinds import Damper, Friction, Spring
from .signals import Constant, Expression, Signal

_REMEMBERED = 16  # models of one system


def cached_force_model(
    system: System,
    springs: Mapping[str, tuple[float, float]],
    forces: Sequence[Force],
    prescribed: Mapping[str, Signal],
    varied: ModelParameters | None = None,
) -> ForceModel:
    """Return the model of springs {joint: (stiffness, rest)}, forces and prescribed joints.

    varied: the numbers of the robot that may vary.
    The last few models of a system as it was loaded are kept, for scenes that differ in their
    start only, or in numbers of the robot that may vary.
    Raises InputError for anything else, or for joints that are not there.
    """
    own, freed, links = system, NOTHING, tuple[int, ...]()
    if varied is not None:
        own, links = nominal(system), varied.links
        freed = freed_of(own, varied.free, varied.placed, varied.turned, generic=True)
    # What is equal acts the same; what cannot be compared by value is kept, and so is itself.
    sprung = [_spring(name, pair) for name, pair in springs.items()]
    key = (
        tuple(sprung),
        *(
            force if isinstance(force, (Spring, Damper, Friction)) else id(force)
            for force in forces
        ),
        *((name, _same(signal)) for name, signal in prescribed.items()),
        freed,
        links,
    )
    models: dict[Hashable, tuple[ForceModel, object]] = once(own, cached_force_model, dict)
    if key not in models:
        model = ForceModel(own, _every(sprung, forces, prescribed), prescribed, freed, links)
        while len(models) >= _REMEMBERED:
            models.pop(next(iter(models)), None)
        models[key] = (model, (tuple(forces), dict(prescribed)))
    model = models[key][0]
    return model if system is own else model.on(system)


def _same(signal: Signal) -> Hashable:
    simple = isinstance(signal, Expression) or (
        isinstance(signal, Constant) and not isinstance(vars(signal)["_given"], Parameter)
    )
    return signal if simple else id(signal)


def _spring(name: str, pair: Any) -> Spring:
    """Return the spring of (stiffness, rest), either of which may be a Parameter."""
    numbers = values_of(list(pair) if isinstance(pair, (list, tuple)) else pair)
    stiffness, rest = spring_pair(name, numbers).tolist()
    for k, parameter in parameters_in(pair):
        stiffness, rest = (parameter, rest) if k == 0 else (stiffness, parameter)
    return Spring(name, stiffness, rest)


def _every(
    springs: Sequence[Force], forces: Sequence[Force], prescribed: Mapping[str, Signal]
) -> list[Force]:
    """Return all forces.  Raises InputError for what is none, or no Signal."""
    every = list(springs)
    for force in forces:
        if not isinstance(force, Force):
            raise InputError(f"forces must be those of pinred.forces, got {brief(force)}")
        every.append(force)
    for name, signal in prescribed.items():
        if not isinstance(signal, Signal):
            raise InputError(f"prescribed['{name}'] must be a Signal, got {signal!r}")
    return every
