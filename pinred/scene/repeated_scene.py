"""Scenes that differ from an earlier scene of a system only in the numbers of the initial state.

Such a scene copies the checked options of the earlier one, and checks its initial state only.  The
key of a call contains the values of all other options, so an option that was changed in place gets
its own scene.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import Any

import numpy as np

from ..common.memo import recent
from ..forces.force_model_cache import NotKeyedError
from ..system.system import System
from .input_formats import list_forces
from .scene import Scene
from .scene_options import ARRAYS_OF_STATE
from .scene_structure import MOST_STRUCTURES, is_empty_table, key_of_option

_STATES = frozenset(ARRAYS_OF_STATE)
_ARRAYS = frozenset({np.ndarray, list, tuple})  # Their entries are checked in each scene.


class _Repeated:
    """The checked options of a scene, without its initial state."""

    def __init__(self, scene: Scene, options: Mapping[str, Any]) -> None:
        """Store the validated options of `scene`, which was built from `options`."""
        self.states = [name for name in options if name in _STATES]
        self.others = [name for name in options if name not in _STATES]
        stated = {*self.states, "_given", "_once", "start"}
        self.checked = {name: v for name, v in vars(scene).items() if name not in stated}
        # Validation returns these options unchanged, so each scene uses its own.
        self.kept = [n for n in self.others if n not in scene.shared.options]

    def with_state(self, options: Mapping[str, Any]) -> Scene:
        """Build a scene from options with the same key as those of the earlier scene."""
        scene = object.__new__(Scene)
        values = vars(scene)
        values.update(self.checked)
        for name in self.states:
            values[name] = options[name]
        for name in self.kept:
            values[name] = options[name]
        if "forces" in self.others:
            values["forces"] = list_forces(options["forces"])
        values["prescribed"] = dict(values["prescribed"])
        values["controls"] = dict(values["controls"])
        if "springs" not in self.others:
            values["springs"] = {}
        scene.resolve_state()
        return scene


def scene_of(system: System, options: Mapping[str, Any]) -> Scene:
    """Return Scene(system=system, **options), faster if only the initial state is new.

    Args:
        system: The system.
        options: Fields of Scene.
    Returns:
        The scene.
    Raises:
        InputError: An option is not valid, or the options contradict each other.
        ShapeError: An array has the wrong shape.
    """
    key = _key_of_call(options)
    if key is None:
        return Scene(system=system, **options)
    first: Scene | None = None

    def make() -> _Repeated:
        nonlocal first
        first = Scene(system=system, **options)
        return _Repeated(first, options)

    repeated = recent(system, key, make, MOST_STRUCTURES, _Repeated)
    return repeated.with_state(options) if first is None else first


def _key_of_call(options: Mapping[str, Any]) -> Hashable:
    """Return the key of a call; None if the initial state does not consist of arrays and lists."""
    try:
        key = tuple(
            [
                (name, (name in _STATES and type(value) in _ARRAYS) or _key_of(name, value))
                for name, value in options.items()
            ]
        )
        hash(key)
    except (NotKeyedError, TypeError):
        return None  # Scene reports an invalid option.
    return key


def _key_of(name: str, value: Any) -> Hashable:
    if name in _STATES:
        if value is None:
            return False
        raise NotKeyedError
    if name == "seed" and value is not None:
        raise NotKeyedError  # The state is drawn for each scene.
    if name == "parameters" and not is_empty_table(value):
        raise NotKeyedError  # Robot parameters replace the system.
    if name == "hold" and value == "others":
        raise NotKeyedError  # The initial state is that of the joints that are held.
    return key_of_option(value)
