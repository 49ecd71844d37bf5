"""The conserved momentum as an arrow in space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ...common.arrays import Array, freeze
from ...system.system import System

STILL = 1e-9  # momentum that counts as zero, relative to √(2mT) of the motion


@dataclass(frozen=True)
class Momentum:
    """The momentum that the group conserves, over F frames; arrays are read-only.

    Attributes:
        vector: Momentum in the world frame, (F, 3); exactly zero if it is round-off.
        tail: Start of the arrow, (F, 3) [m].
        words: Description of the momentum.
        unit: Unit of the momentum.
    """

    vector: Array
    tail: Array
    words: str
    unit: str

    def __post_init__(self) -> None:
        freeze(self)


def conserved_momentum(system: System, q: Array, v: Array) -> Momentum:
    """Compute the momentum arrow by Pinocchio's centroidal momentum.

    If the base can rotate, it is the angular momentum about the centre of mass or the pivot, along
    the axes of rotation; otherwise it is the linear momentum along the axes of translation.

    Args:
        system: The robot.
        q: Pinocchio's configurations, (F, nq).
        v: Pinocchio's velocities, (F, n).
    Returns:
        The arrow at all frames.
    """
    model, data = system.model, system.model.createData()
    linear, slides = system.group.linear, not system.group.turns
    pivoted = not (slides or system.group.turns_about_com)
    pivot = np.array(model.jointPlacements[1].translation)
    axes, rotor = _axes(system), model.armature
    about = slice(0 if slides else linear, system.r)
    vector, tail, most = np.empty((len(q), 3)), np.empty((len(q), 3)), 0.0
    for k in range(len(q)):
        pin.ccrba(model, data, q[k], v[k])
        tail[k] = pivot if pivoted else data.com[0]
        arm = data.com[0] - tail[k]
        spin = data.hg.angular + np.cross(arm, data.hg.linear)
        momentum = data.hg.linear if slides else spin
        vector[k] = axes @ (axes.T @ momentum + rotor[about] * v[k, about])
        mass, size = data.Ig.mass, np.sqrt(np.trace(data.Ig.inertia) / data.Ig.mass)
        carried = np.sqrt(2.0 * mass * pin.computeKineticEnergy(model, data, q[k], v[k]))
        most = max(most, float(carried * (1.0 if slides else size + np.linalg.norm(arm))))
    vector[np.linalg.norm(vector, axis=1) <= STILL * most] = 0.0
    return Momentum(vector, tail, *_words(system))


def _axes(system: System) -> Array:
    """Return the unit axes (3, k) of the arrow's momentum in the world frame.

    They are axes of the root joint's frame, which the motion keeps fixed if there are fewer than 3.
    """
    model, data = system.model, system.model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    motion = np.array(data.joints[1].S).reshape(6, system.r)
    linear = system.group.linear
    axes = motion[3:, linear:] if system.group.turns else motion[:3]
    return np.asarray(model.jointPlacements[1].rotation @ axes)


def _words(system: System) -> tuple[str, str]:
    """Return the description of the momentum, and its unit."""
    group = system.group
    if not group.turns:
        return "momentum along the axis" if group.dim == 1 else "momentum", "kg m/s"
    if group.turns_about_com:
        return "angular momentum about the centre of mass", "kg m²/s"
    about = "the axis" if group.turns == 1 else "the pivot"
    return f"angular momentum about {about}", "kg m²/s"
