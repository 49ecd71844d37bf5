"""Rotors of the base's joints (armature) as an inertia without weight, where they are one.

Pinocchio adds armature to the diagonal of the mass matrix, which of several joints at a root
gives wrong accelerations.  Rotors that resist alike in all directions are a mass, or a moment
of inertia, on the base, exact where gravity does not act on it; others break the symmetry.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NoReturn

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...common.errors import ModelError
from .joints import Joint

_EXACT = 1e-12  # cosines and relative sizes, below which they are round-off


def of_slides(slides: Sequence[Joint], gravity: Array) -> pin.Inertia:
    """Return the rotors of slides ahead of all other joints, at the joints' origin.

    gravity: (3,) along the axes in which the slides' are given.  Raises ModelError.
    """
    rotors = _rotors(slides)
    if not rotors.any():
        return pin.Inertia.Zero()
    axes = np.array([joint.axis for joint in slides])
    at_right_angles = np.abs(axes @ axes.T - np.eye(len(axes))).max() <= _EXACT
    if np.ptp(rotors) != 0.0 or not at_right_angles:
        _refuse(slides, "it must be the same in directions that are at right angles")
    _refuse_falling(slides, gravity, axes)
    return _mass(rotors[0])


def of_ball(joint: Joint) -> pin.Inertia:
    """Return the rotors that a ball turns, or a free joint; they have no gyroscopic moment."""
    turning = joint.armature[-3:]
    if np.ptp(turning) != 0.0:
        _refuse([joint], "it must be the same in all directions")
    return pin.Inertia(0.0, np.zeros(3), turning[0] * np.eye(3))


def of_free(joint: Joint, gravity: Array) -> pin.Inertia:
    """Return the rotors of a free joint.  gravity: (3,) in the world.  Raises ModelError."""
    sliding = joint.armature[:3]
    if np.ptp(sliding) != 0.0:
        _refuse([joint], "it must be the same in all directions")
    if sliding.any():
        _refuse_falling([joint], gravity, np.eye(3))
    return _mass(sliding[0]) + of_ball(joint)


def of_plane(joints: Sequence[Joint], gravity: Array) -> pin.Inertia:
    """Return the rotors of slides and hinges that move in a plane, on axes with z across it.

    gravity: (3,) along the axes in which the joints' are given.  Raises ModelError.
    """
    slides = [joint for joint in joints if joint.kind == "slide"]
    hinges = [joint for joint in joints if joint.kind == "hinge"]
    if len(hinges) > 1 and _rotors(hinges).any():
        _refuse(hinges, "two hinges turn the body together, so that their rotors are no inertia")
    ahead = list(joints[: len(slides)]) == slides and len(hinges) == 1
    if _rotors(slides).any() and not ahead:
        _refuse(slides, "a hinge ahead of them, or no second slide, breaks the symmetry")
    turning = np.diag([0.0, 0.0, hinges[0].armature[0]])
    return of_slides(slides, gravity) + pin.Inertia(0.0, np.zeros(3), turning)


def _mass(mass: float) -> pin.Inertia:
    return pin.Inertia(float(mass), np.zeros(3), np.zeros((3, 3)))


def _rotors(joints: Sequence[Joint]) -> Array:
    return np.concatenate([np.empty(0), *(joint.armature for joint in joints)])


def _refuse_falling(joints: Sequence[Joint], gravity: Array, axes: Array) -> None:
    """Refuse rotors that gravity would make fall, if it has a part along the axes."""
    if np.abs(axes @ gravity).max() > _EXACT * np.linalg.norm(gravity):
        _refuse(joints, "gravity acts along them, and rotors have no weight to fall with")


def _refuse(joints: Sequence[Joint], why: str) -> NoReturn:
    names = ", ".join(f"'{joint.name}'" for joint in joints)
    values = ", ".join(f"{value:g}" for value in _rotors(joints))
    raise ModelError(
        f"the joints {names} of the base have armature {values}: {why}; set it to zero, or add it "
        "to the inertia of the body"
    )
