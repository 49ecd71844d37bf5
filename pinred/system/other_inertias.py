"""A system with other inertias of some bodies, and the one it was made of."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy

import pinocchio as pin

from .system import System


def nominal(system: System) -> System:
    """Return the system as it was loaded: itself, unless its bodies were given other inertias."""
    found: System = vars(system).get("_nominal", system)
    return found


def with_inertias(system: System, inertias: Mapping[int, pin.Inertia]) -> System:
    """Return a system with other inertias of some bodies, {joint of the model: inertia}."""
    other = copy(system)  # without what was made for its own inertias
    own = vars(other)
    own["model"], own["_nominal"] = system.model.copy(), nominal(system)
    for joint, inertia in inertias.items():
        other.model.inertias[joint] = inertia
    return other
