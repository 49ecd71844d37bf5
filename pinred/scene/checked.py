"""Options of a scene that are checked alone: a keyframe, a seed, a list of forces."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..common.arrays import entries_of
from ..common.errors import InputError
from ..common.plain_names import brief, listed, one_of
from ..forces.force import Force
from ..system.system import System


def checked_keyframe(system: System, name: str) -> str:
    """Return the name of a keyframe if the robot has it.  Raises InputError."""
    if not one_of(name, system.keyframes):
        known = listed(list(system.keyframes), 60) or "none"
        raise InputError(
            f"keyframe: '{system.name}' has no keyframe {brief(name)}; the keyframes are {known}"
        )
    return name


def checked_seed(seed: Any) -> int:
    """Return a seed as a whole number from 0.  Raises InputError."""
    if isinstance(seed, bool) or not (isinstance(seed, (int, np.integer)) and seed >= 0):
        raise InputError(f"seed must be a whole number from 0, got {brief(seed)}")
    return int(seed)


def listed_forces(given: Any) -> tuple[Any, ...]:
    """Return the forces of a scene as they are given, one or several, or None for none."""
    if given is None or isinstance(given, Force):
        return () if given is None else (given,)
    entries = entries_of(given)
    if entries is None:
        raise InputError(f"forces must be a list of those of pinred.forces, got {brief(given)}")
    return tuple(entries)
