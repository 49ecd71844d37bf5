"""Tumbling: the effect of momentum on the base during and after a reorientation.

Joint motion can rotate a tumbling base but not stop it.  Once the joints are at rest, the body
twist is I⁻¹Ad_gᵀJ, fixed by the spatial momentum J, the attitude and the shape.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ...analysis.phases.lift import STAGES, PathSegments, in_space_by_momenta, lift
from ...analysis.phases.path_basis import Drift
from ...common.arrays import Array, vector
from ...common.errors import InputError
from ...system.system import System
from ..optimisation.aims import TargetAim, rotation_between
from ..optimisation.transcription import Passage

_TURN = 2.0 * np.pi
_PER_RADIAN = 4  # quadrature pieces for each radian of tumbling
_MOST = 200.0  # largest tumbling angle of a plan [rad]


def initial_momentum(system: System, momentum: ArrayLike | float) -> Array:
    """Return the initial body momentum, (r,), or zeros for 0.  Raises ShapeError."""
    if np.ndim(momentum) == 0 and momentum == 0:
        return np.zeros(system.r)
    return vector(np.asarray(momentum), system.r, "momentum", system.group.twist_names)


def passage_of(system: System, momentum: Array, start: Array, cycles: int, time: float) -> Passage:
    """Create a motion from rest to rest with momentum.

    Args:
        system: The system.
        momentum: Initial body momentum, (r,).
        start: Initial shape, (m,).
        cycles: Number of cycles.
        time: Total duration [s].
    Returns:
        The motion, with enough quadrature pieces for the tumbling.
    Raises:
        InputError: The base would tumble too far.
    """
    drift = Drift(system, time * momentum)
    (inverse,) = drift.inverse(start[None])
    angle = float(np.linalg.norm((inverse @ drift.momentum)[system.group.linear :]))
    if not angle <= _MOST:
        raise InputError(
            f"with joints at rest the base would tumble through {angle:.3g} rad in {time:g} s; "
            "give a shorter duration"
        )
    return Passage(cycles, drift, int(_PER_RADIAN * angle) + 1)


def joint_rotation(
    system: System, passage: Passage, start: Array, aim: TargetAim
) -> tuple[TargetAim, Array]:
    """Compute the rotation that the joints must contribute to a target.

    Full turns of an angle do not count, so the target nearest to the drifted angle is used.

    Args:
        system: The system.
        passage: The motion from rest to rest.
        start: Initial shape, (m,).
        aim: The target.
    Returns:
        The target, and its difference to the drift of the base with joints at rest, (turns,).
    """
    group, drift = system.group, passage.drift
    count = passage.more + STAGES
    inverse = in_space_by_momenta(group, drift.inverse(start[None]))
    still = PathSegments(
        h=np.full(count, 1.0 / count),
        a=np.zeros((count, STAGES, 6)),
        L=np.ascontiguousarray(np.broadcast_to(inverse, (count, STAGES, 6, 6))),
    )
    drifted = lift(group, still, drift.momentum)[-1][group.linear :]
    if group.turns == 1:
        turns = np.round((drifted - aim.attitude) / _TURN)
        aim = TargetAim(group, aim.attitude + _TURN * turns, None)
        return aim, np.asarray(aim.attitude - drifted)
    return TargetAim(group, aim.attitude, None), rotation_between(drifted, aim.attitude)


def final_twist(system: System, momentum: Array, shape: Array, pose: Array) -> Array:
    """Compute the twist I⁻¹Ad_gᵀJ of a base with joints at rest.

    Args:
        system: The system.
        momentum: Spatial momentum J, (r,).
        shape: Shape, (m,).
        pose: Pose, (size,).
    Returns:
        (r,): the body twist.
    """
    (inverse,) = Drift(system, momentum).inverse(shape[None])
    return np.asarray(inverse @ system.group.Ad(pose).T @ momentum)
