"""Copies of a system with different gravity, inertias and placements."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ..common.arrays import Array, vector
from ..common.errors import InputError
from .system import System

_HUGE = 1e100  # largest accepted gravity, because products of larger numbers overflow [m/s²]


def nominal(system: System) -> System:
    """Return the system as it was loaded, before any parameters were changed."""
    loaded: System = vars(system).get("_nominal", system)
    return loaded


def in_gravity(system: System, gravity: Array) -> System:
    """Return a copy of a system with different gravity, (3,) in the world frame [m/s²]."""
    other = _copy(system)
    for model in (other.model, other.sorted_model):
        model.gravity.linear = gravity
    return other


def checked_gravity(value: ArrayLike) -> Array:
    """Return gravity as a vector, (3,) [m/s²].  Raises ShapeError, or InputError if it is huge."""
    gravity = vector(value, 3, "gravity")
    if np.abs(gravity).max() > _HUGE:
        raise InputError(f"gravity must be below {_HUGE:g} m/s², got {gravity}")
    return gravity


def with_numbers(
    system: System,
    inertias: Mapping[int, pin.Inertia],
    placements: Mapping[int, pin.SE3] | None = None,
    frames: Mapping[int, pin.SE3] | None = None,
) -> System:
    """Return a copy of a system with different inertias and placements.

    Args:
        system: System to copy.
        inertias: New inertias of bodies, {joint of `sorted_model` that moves the body: inertia}.
        placements: New joint placements, {joint index in `sorted_model`: placement}.
        frames: New placements of links on their bodies, {frame index in both models: placement}.
    """
    other = _copy(system)
    vars(other)["_nominal"] = nominal(system)
    names = system.sorted_model.names
    for model in (other.model, other.sorted_model):
        for joint, inertia in inertias.items():
            model.inertias[model.getJointId(names[joint])] = inertia
        for joint, placement in (placements or {}).items():
            model.jointPlacements[model.getJointId(names[joint])] = placement
        for frame, placement in (frames or {}).items():
            model.frames[frame].placement = placement
    return other


def _copy(system: System) -> System:
    """Return a copy with separate models, without the work spaces of the original."""
    other = copy(system)
    model = sorted_model = system.model.copy()
    if system.sorted_model is not system.model:
        sorted_model = system.sorted_model.copy()
    vars(other).update(model=model, sorted_model=sorted_model)
    return other
