"""Checked options that scenes share if they differ only in the numbers of their initial states.

A scene checks its options and builds its force model once for each structure, that is, for all
options except the numbers of the initial state.  A system keeps the structures that were used most
recently.  A scene with an option that may change in place, such as a controller, shares nothing.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from ..forces.force import Force
from ..forces.force_model_cache import PLAIN, NotKeyedError, key_of, key_of_force
from ..integrators.methods import Method
from .scene_options import SCENE_OPTIONS, SceneFields

_NUMBERS = frozenset({float, int})
MOST_STRUCTURES = 16  # largest number of structures that a system keeps
_STATE = tuple(name for name, option in SCENE_OPTIONS.items() if option.table == "start")
_OTHERS = tuple(name for name in SCENE_OPTIONS if name not in _STATE)


class Shared:
    """The checked options of all scenes of one structure.

    Plans store here what they compute for all of these scenes.

    Attributes:
        options: Fields of a scene that do not depend on the initial state.
    """

    def __init__(self, options: Mapping[str, Any]) -> None:
        """Store the checked options."""
        self.options = options


def structure_key(scene: SceneFields) -> Hashable:
    """Return the key of a scene whose options are not yet checked; None without a key."""
    options = vars(scene)
    if not is_empty_table(options["parameters"]):
        return None  # Robot parameters replace the system.
    if options["hold"] == "others":
        return None  # The initial state is that of the joints that are held.
    try:
        key = (
            tuple([_key_of_state(options[name]) for name in _STATE]),
            *[key_of_option(options[name]) for name in _OTHERS],
        )
        hash(key)
    except (NotKeyedError, TypeError):
        return None  # The checks of the scene report an invalid option.
    return key


def is_empty_table(value: Any) -> bool:
    """Return whether a value is a mapping without entries."""
    return type(value) in (dict, MappingProxyType) and not value


def _key_of_state(value: Any) -> Hashable:
    """Return whether an option of the initial state is stated; the name itself of a keyframe."""
    return value if type(value) is str else value is not None


def key_of_option(value: Any) -> Hashable:
    """Return the key of an option that does not belong to the initial state."""
    kind = type(value)
    if kind in PLAIN:
        return kind, value
    if kind in (dict, tuple) and not value:
        return kind.__name__
    if kind is np.ndarray:
        return key_of(value)
    if kind is list and {*map(type, value)} <= _NUMBERS:
        return kind, tuple(map(type, value)), tuple(value)
    if isinstance(value, Force):
        return key_of_force(value)
    if kind in (list, tuple) and any(isinstance(entry, Force) for entry in value):
        return kind, tuple(map(key_of_option, value))
    if isinstance(value, Method):
        # Equal methods may differ in whether the user stated their tolerances.
        return kind, key_of(vars(value))
    if kind is MappingProxyType:
        return key_of(dict(value))
    return key_of(value)
