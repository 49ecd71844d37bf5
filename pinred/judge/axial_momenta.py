"""Drift of the constant momenta of symmetric bodies on balls, computed with Pinocchio."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..reduction.symmetric_balls import SymmetricBall
from ..system.state_fields import State
from ..system.system import System


def axial_momentum_drifts(
    system: System, balls: Sequence[SymmetricBall], states: State
) -> list[Array]:
    """Compute the changes of π · n of symmetric balls, of all of π for spherical rotors.

    The unit is the momentum of the body at the largest angular velocity of base and joints.

    Args:
        system: The system.
        balls: Balls whose momentum about an axis of symmetry of their body is constant.
        states: States at T times.
    Returns:
        Relative changes since the first time, (T,) each.
    """
    if not balls:
        return []
    model, data, k = system.sorted_model, system.sorted_data, system.group.linear
    is_angular = np.array([unit == "rad" for unit in system.units])
    rates = np.hstack([states.xi[:, k:], states.xdot[:, is_angular]])
    fastest = float(np.abs(rates).max(initial=0.0)) or 1.0
    momenta: list[list[Array]] = [[] for _ in balls]
    for q, v in zip(system.sort_q(states.q), system.sort_v(states.v), strict=True):
        pin.forwardKinematics(model, data, q, v)
        for ball, rows in zip(balls, momenta, strict=True):
            i = system.sorted_joints[ball.joint.v.start]
            at = slice(model.idx_vs[i], model.idx_vs[i] + 3)
            own = (model.inertias[i] * data.v[i]).angular + model.armature[at] * v[at]
            rows.append(own if ball.axis is None else np.atleast_1d(ball.axis @ own))
    drifts: list[Array] = []
    for ball, rows in zip(balls, momenta, strict=True):
        i = system.sorted_joints[ball.joint.v.start]
        moment = float(np.trace(model.inertias[i].inertia)) + model.armature[model.idx_vs[i]]
        drifts += list((np.array(rows) - rows[0]).T / (moment * fastest))
    return drifts
