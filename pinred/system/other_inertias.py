"""A system with other inertias, placements and links, and the one it was made of."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy

import pinocchio as pin

from .system import System


def nominal(system: System) -> System:
    """Return the system as it was loaded: itself, unless it was given other numbers."""
    found: System = vars(system).get("_nominal", system)
    return found


def with_numbers(
    system: System,
    inertias: Mapping[int, pin.Inertia],
    placements: Mapping[int, pin.SE3] | None = None,
    frames: Mapping[int, pin.SE3] | None = None,
) -> System:
    """Return a system with other inertias of some bodies, and other placements of some joints.

    Both by joint of the model.  frames: other places of links on their bodies, by frame of it.
    """
    other = copy(system)  # without what was made for its own numbers
    own = vars(other)
    own["model"], own["_nominal"] = system.model.copy(), nominal(system)
    for joint, inertia in inertias.items():
        other.model.inertias[joint] = inertia
    for joint, placement in (placements or {}).items():
        other.model.jointPlacements[joint] = placement
    for frame, placement in (frames or {}).items():
        other.model.frames[frame].placement = placement
    return other
