"""Copies of a system with other numbers: gravity, inertias, and placements."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy

import pinocchio as pin

from ..common.arrays import Array
from .system import System


def nominal(system: System) -> System:
    """Return the system as it was loaded, before any of its parameters was varied."""
    loaded: System = vars(system).get("_nominal", system)
    return loaded


def in_gravity(system: System, gravity: Array) -> System:
    """Return a copy of a system in another gravity, (3,) in the world frame [m/s²]."""
    other = _copy(system)
    other.model.gravity.linear = gravity
    return other


def with_numbers(
    system: System,
    inertias: Mapping[int, pin.Inertia],
    placements: Mapping[int, pin.SE3] | None = None,
    frames: Mapping[int, pin.SE3] | None = None,
) -> System:
    """Return a copy of a system with other inertias and placements.

    Args:
        system: System to copy.
        inertias: Inertias by joint of the model that moves the body.
        placements: Placements by joint of the model.
        frames: Placements of links on their bodies, by frame of the model.
    """
    other = _copy(system)
    vars(other)["_nominal"] = nominal(system)
    for joint, inertia in inertias.items():
        other.model.inertias[joint] = inertia
    for joint, placement in (placements or {}).items():
        other.model.jointPlacements[joint] = placement
    for frame, placement in (frames or {}).items():
        other.model.frames[frame].placement = placement
    return other


def _copy(system: System) -> System:
    """Return a copy with a separate model, without the work spaces of the original."""
    other = copy(system)
    vars(other)["model"] = system.model.copy()
    return other
