"""Tumbling of a base with momentum during a motion of its joints from rest to rest."""

from __future__ import annotations

import numpy as np

from ...analysis.connections.connection import Connection
from ...analysis.phases.lift import STAGES, PathSegments, in_space_by_momenta, lift
from ...analysis.phases.path_basis import Drift
from ...common.arrays import Array
from ...common.errors import InputError
from ...lie.group import Group
from ..optimisation.objective import TargetAim, rotation_between
from ..optimisation.transcription import Passage

_TURN = 2.0 * np.pi
_PER_RADIAN = 4  # number of quadrature segments per radian of tumbling
_MOST = 200.0  # largest tumbling angle of a plan [rad]


def passage_of(
    connection: Connection, momentum: Array, start: Array, cycles: int, time: float
) -> Passage:
    """Create a motion from rest to rest with momentum.

    Args:
        connection: The mechanical connection.
        momentum: Initial body momentum, (r,).
        start: Initial shape, (m,).
        cycles: Number of cycles.
        time: Total duration [s].
    Returns:
        The motion, with enough quadrature segments to resolve the tumbling.
    Raises:
        InputError: The base would tumble too far.
    """
    drift = Drift(connection.code, time * momentum)
    (inverse,) = drift.inverse(start[None])
    angle = float(np.linalg.norm((inverse @ drift.momentum)[connection.group.linear :]))
    if not angle <= _MOST:
        raise InputError(
            f"with joints at rest the base would tumble through {angle:.3g} rad in {time:g} s; "
            "give a shorter duration"
        )
    return Passage(cycles, drift, int(_PER_RADIAN * angle) + 1)


def joint_rotation(
    group: Group, passage: Passage, start: Array, aim: TargetAim
) -> tuple[TargetAim, Array]:
    """Compute the rotation that the joints must contribute to a target.

    Angles that differ by full turns are the same attitude, so the angle nearest to that of the
    drifted base is used.

    Args:
        group: The symmetry group.
        passage: The motion from rest to rest.
        start: Initial shape, (m,).
        aim: The target.
    Returns:
        The target, and the rotation to it from the attitude that the base would drift to with
        joints at rest, (turns,).
    """
    drift = passage.drift
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


def final_twist(connection: Connection, momentum: Array, shape: Array, pose: Array) -> Array:
    """Compute the twist I⁻¹Ad_gᵀJ of a base with joints at rest.

    Args:
        connection: The mechanical connection.
        momentum: Spatial momentum J, (r,).
        shape: Shape, (m,).
        pose: Pose, (size,).
    Returns:
        (r,): the body twist.
    """
    (inverse,) = Drift(connection.code, momentum).inverse(shape[None])
    return np.asarray(inverse @ connection.group.Ad(pose).T @ momentum)
