"""A system in another gravity."""

from __future__ import annotations

from copy import copy

from ..common.arrays import Array
from .system import System


def in_gravity(system: System, gravity: Array) -> System:
    """Return a system as it is, but in a gravity (3,) of the world frame [m/s²]."""
    other, model = copy(system), system.model.copy()
    vars(other).pop("_once", None)  # what was made for the other gravity
    model.gravity.linear = gravity
    object.__setattr__(other, "model", model)
    return other
