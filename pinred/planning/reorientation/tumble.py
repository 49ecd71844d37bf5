"""Tumbling: what momentum does to a base on the way, and what it leaves in the end.

Joint motion turns a base that tumbles, too, but cannot stop it: where the joints are at rest again,
its twist is I⁻¹Ad_gᵀJ, fixed by the spatial momentum J, the attitude and the shape.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ...analysis.phases.drift import Drift
from ...analysis.phases.lift import STAGES, PathSegments, in_space_by_momenta, lift
from ...common.arrays import Array, vector
from ...common.errors import InputError
from ...system.system import System
from ..optimisation.aims import Reach, rotation_between
from ..optimisation.transcription import Passage

_TURN = 2.0 * np.pi
_PER_RADIAN = 4  # pieces
_MOST = 200.0  # rad of tumbling that a plan takes on


def momentum_of(system: System, momentum: ArrayLike | float) -> Array:
    """Return the body momentum at the start, (r,); 0 for none.  Raises ShapeError."""
    if np.ndim(momentum) == 0 and momentum == 0:
        return np.zeros(system.r)
    return vector(np.asarray(momentum), system.r, "momentum", system.group.twist_names)


def passage_of(system: System, momentum: Array, start: Array, cycles: int, time: float) -> Passage:
    """Return so many cycles from rest to rest in a time [s], from a shape (m,) on."""
    drift = Drift(system, time * momentum)
    (inverse,) = drift.inverse(start[None])
    turned = float(np.linalg.norm((inverse @ drift.momentum)[system.group.linear :]))
    if not turned <= _MOST:
        raise InputError(
            f"at rest the joints would see the base tumble through {turned:.3g} rad in {time:g} s; "
            "give a shorter duration"
        )
    return Passage(cycles, drift, int(_PER_RADIAN * turned) + 1)


def joints_share(system: System, passage: Passage, start: Array, aim: Reach) -> tuple[Reach, Array]:
    """Return the aim, and what of it joints at rest do not reach, (turns,): the share of a loop.

    Of an angle whole turns do not count: the aim is the one next to where the base drifts.
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
        aim = Reach(group, aim.attitude + _TURN * turns, None)
        return aim, np.asarray(aim.attitude - drifted)
    return Reach(group, aim.attitude, None), rotation_between(drifted, aim.attitude)


def twist_left(system: System, momentum: Array, shape: Array, pose: Array) -> Array:
    """Return I⁻¹Ad_gᵀJ, (r,): the twist of a base at a pose whose joints rest in a shape (m,)."""
    (inverse,) = Drift(system, momentum).inverse(shape[None])
    return np.asarray(inverse @ system.group.Ad(pose).T @ momentum)
