"""Checked options that scenes share if they differ only in the numbers of their initial states.

A scene checks its options and builds its force model once for each structure, that is, for all
options except the numbers of the initial state.  A system keeps the structures that were used most
recently.  A scene with an option that may change in place, such as a controller, shares nothing.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from ..common.errors import InputError
from ..forces.force_keys import NotKeyedError, key_of, key_of_array, key_of_force, key_of_plain
from ..integrators.methods import Method
from .option_checks import list_forces

if TYPE_CHECKING:
    from .scene import Scene

MOST_STRUCTURES = 16  # largest number of structures that a system keeps
# Options of the initial state; only whether they are stated belongs to the structure.
_STATE = ("x0", "xdot0", "xi0", "momentum", "seed", "pose0", "q0", "v0")
_PLAIN = ("keyframe", "duration", "rtol", "atol", "passive", "friction", "outputs")

# Fields of a scene that the checks of a structure set.
CHECKED = (
    "system", "outputs", "rtol", "atol", "method", "duration", "forces", "prescribed", "friction",
    "events", "parameters", "_parameters", "_times", "_forces", "_watched",
)  # fmt: skip


class Shared:
    """The checked options of all scenes of one structure.

    Plans store here what they compute for all of these scenes.

    Attributes:
        options: Fields of a scene that do not depend on the initial state.
    """

    def __init__(self, options: Mapping[str, Any]) -> None:
        """Store the checked options."""
        self.options = options


def structure_key(scene: Scene) -> Hashable:
    """Return the key of a scene whose options are not yet checked; None without a key."""
    options = vars(scene)
    parameters, events = options["parameters"], options["events"]
    if type(parameters) not in (dict, MappingProxyType) or parameters:
        return None
    if type(events) is not tuple or events:
        return None
    stated = tuple([options[name] is not None for name in _STATE])
    try:
        key = (
            stated,
            *[key_of_plain(options[name]) for name in _PLAIN],
            _key_of_times(options["times"]),
            _key_of_method(options["method"]),
            key_of(options["springs"]),
            tuple(map(key_of_force, list_forces(options["forces"]))),
            key_of(options["prescribed"]),
        )
        hash(key)
    except (NotKeyedError, InputError, TypeError):
        return None  # The checks of the scene report an invalid option.
    return key


def _key_of_times(times: Any) -> Hashable:
    return key_of_array(times) if isinstance(times, np.ndarray) else key_of(times)


def _key_of_method(method: Any) -> Hashable:
    if not isinstance(method, Method):
        return key_of_plain(method)
    # Equal methods may differ in whether the user stated their tolerances.
    return type(method), key_of(vars(method))
