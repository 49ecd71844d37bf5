"""The momentum sphere: the conserved angular momentum as one body sees it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...common.arrays import Array, FrozenArrays
from ...common.errors import InputError
from ...common.names import quoted
from ...lie.rotations import rotation
from ...system.system import System

BASE = "base"  # name of the base where joints name their bodies


@dataclass(frozen=True)
class MomentumSphere(FrozenArrays):
    """The angular momentum in the axes of one body; arrays are read-only.

    A body of a freely turning robot sees a constant momentum move on a sphere. For a rigid robot
    the path is the polhode.

    Attributes:
        joint: Index of the joint that moves the body.
        body: Name of the joint, or "base".
        path: R_jᵀL, relative to the largest |L|, (F, 3).
    """

    joint: int
    body: str
    path: Array


def momentum_sphere(
    system: System, body: str, placements: Array, momentum: Array
) -> MomentumSphere:
    """Compute the path of the angular momentum in the axes of a body.

    Args:
        system: The robot.
        body: Name of the joint that moves the body, or "base".
        placements: Placements of the joints in the world frame, (F, joints, 7).
        momentum: Angular momentum in the world frame, (F, 3).
    Returns:
        The path.
    Raises:
        InputError: There is no such joint, the robot does not turn in space, or its angular
            momentum is zero.
    """
    names = [BASE, *map(str, list(system.sorted_model.names)[2:])]
    if body not in names:
        raise InputError(
            f"sphere: no joint {quoted(body)}; the bodies are named {', '.join(names)}"
        )
    if system.group.turns < 3:
        raise InputError(
            f"sphere: the momentum sphere needs a robot that turns in space, and the group of "
            f"{system.name or 'the robot'} is {system.group.name}; leave the option out"
        )
    largest = float(np.linalg.norm(momentum, axis=1).max())
    if not largest > 0.0:
        raise InputError(
            "sphere: the angular momentum is zero, so it has no path on a sphere; start with a "
            "momentum (momentum=, --momentum), or leave the option out"
        )
    joint = 1 + names.index(body)
    turned = np.einsum("fji,fj->fi", rotation(placements[:, joint, 3:]), momentum)
    return MomentumSphere(joint=joint, body=body, path=turned / largest)
