"""Rotors of the base's joints (armature) as an equivalent inertia on the base.

Pinocchio adds armature to the diagonal of the mass matrix, which is wrong for several joints at
a root.  Rotors with equal armature in all directions act like a mass, or a moment of inertia, on
the base.  This equivalence is exact if gravity does not act on the mass.  Other rotors break the
symmetry.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NoReturn

import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...common.errors import ModelError
from .mujoco_joints import Joint

_EXACT = 1e-12  # cosines and relative sizes below this value count as zero


def of_slides(slides: Sequence[Joint], gravity: Array) -> pin.Inertia:
    """Return the rotor inertia of slides before all other joints, at the joints' origin.

    gravity: (3,) [m/s²], in the frame of the slides' axes.  Raises ModelError.
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
    """Return the rotor inertia of a ball.

    It must be the same in all directions, so that it causes no gyroscopic moment.
    """
    if np.ptp(joint.armature) != 0.0:
        _refuse([joint], "it must be the same in all directions")
    return pin.Inertia(0.0, np.zeros(3), joint.armature[0] * np.eye(3))


def ignored_rotors(joints: Sequence[Joint]) -> tuple[str, ...]:
    """Return a warning for each free joint with armature.

    No motor drives a free joint, so such armature is ignored.  Files usually inherit it from the
    <default> of their other joints.
    """
    return tuple(
        f"free joint '{joint.name}' has armature {joint.armature.max():g}, which is ignored; add "
        "it to the inertia of the body to keep it"
        for joint in joints
        if joint.kind == "free" and joint.armature.any()
    )


def of_plane(joints: Sequence[Joint], gravity: Array) -> pin.Inertia:
    """Return the rotor inertia of planar slides and hinges, in axes with z normal to the plane.

    gravity: (3,) [m/s²], in the frame of the joints' axes.  Raises ModelError.
    """
    slides = [joint for joint in joints if joint.kind == "slide"]
    hinges = [joint for joint in joints if joint.kind == "hinge"]
    if len(hinges) > 1 and _rotors(hinges).any():
        _refuse(hinges, "two hinges turn the body together, and their rotors equal no inertia")
    ahead = list(joints[: len(slides)]) == slides and len(hinges) == 1
    if _rotors(slides).any() and not ahead:
        _refuse(slides, "a hinge ahead of them, or no second slide, breaks the symmetry")
    angular = np.diag([0.0, 0.0, hinges[0].armature[0]])
    return of_slides(slides, gravity) + pin.Inertia(0.0, np.zeros(3), angular)


def _mass(mass: float) -> pin.Inertia:
    return pin.Inertia(float(mass), np.zeros(3), np.zeros((3, 3)))


def _rotors(joints: Sequence[Joint]) -> Array:
    return np.concatenate([np.empty(0), *(joint.armature for joint in joints)])


def _refuse_falling(joints: Sequence[Joint], gravity: Array, axes: Array) -> None:
    """Reject armature if gravity acts along the axes, because armature has no weight."""
    if np.abs(axes @ gravity).max() > _EXACT * np.linalg.norm(gravity):
        _refuse(joints, "gravity acts along them, but armature has no weight")


def _refuse(joints: Sequence[Joint], why: str) -> NoReturn:
    names = ", ".join(f"joint '{joint.name}'" for joint in joints)
    values = ", ".join(f"{value:g}" for value in _rotors(joints))
    raise ModelError(
        f"the base has {names} with armature {values}: {why}; set it to zero, or add it to the "
        "inertia of the body"
    )
