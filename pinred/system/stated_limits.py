"""Limits of joints in a robot's file or a pin.Model, which no simulation enforces."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import get_args

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..common.memo import once
from .robot_file_contents import LeftOut, LimitKind, StatedLimit
from .system import System, nominal
from .urdf_elements import UNLIMITED

POSITION, VELOCITY, EFFORT = ("joint limits", "velocity limits", "effort limits")


def stated_limits(
    raw: pin.Model, *, locked: Collection[str] = (), merged: Collection[str] = ()
) -> tuple[LeftOut, ...]:
    """Return the limits of the joints that can move, by kind.

    A velocity or effort limit of zero counts as not stated, because the format of URDF demands
    both numbers and many files fill them with zeros.

    Args:
        raw: Model with all joints of the file.
        locked: Names of locked joints, whose limits do not matter.
        merged: Names of hinges that became balls.  Their position limits are listed elsewhere.
    """
    names: dict[str, list[str]] = {POSITION: [], VELOCITY: [], EFFORT: []}
    for i in range(1, raw.njoints):
        name, joint = str(raw.names[i]), raw.joints[i]
        if name in locked:
            continue
        q = slice(joint.idx_q, joint.idx_q + joint.nq)
        v = slice(joint.idx_v, joint.idx_v + joint.nv)
        positions = [raw.lowerPositionLimit[q], raw.upperPositionLimit[q]]
        # Positions that are no angle or length, such as cosines, have bounds by their nature.
        if joint.nq == joint.nv and name not in merged and _has_bound(*positions):
            names[POSITION].append(name)
        if _has_bound(_nonzero(raw.lowerVelocityLimit[v]), _nonzero(raw.upperVelocityLimit[v])):
            names[VELOCITY].append(name)
        if _has_bound(_nonzero(raw.lowerEffortLimit[v]), _nonzero(raw.upperEffortLimit[v])):
            names[EFFORT].append(name)
    return tuple(
        LeftOut(kind, tuple(joints), demanded=True) for kind, joints in names.items() if joints
    )


@dataclass(frozen=True)
class JointLimits:
    """The lowest and highest values of the joints of a shape; infinite where the file states none.

    Attributes:
        position: Positions, (m, 2) [rad | m]; infinite for continuous joints and balls.
        rate: Rates, (m, 2) [rad/s | m/s]; infinite for balls.
        effort: Torques, (m, 2) [N·m | N]; infinite for balls.
    """

    position: Array
    rate: Array
    effort: Array


def joint_limits(system: System) -> JointLimits:
    """Return the limits in a robot's file; a rate or effort limit of zero is none.

    Args:
        system: The robot.
    """
    limits = {kind: np.tile([-np.inf, np.inf], (system.m, 1)) for kind in get_args(LimitKind)}
    rows = {name: k for k, name in enumerate(system.shape_names)}
    for limit in limits_of(system):
        if limit.joint in rows:
            limits[limit.kind][rows[limit.joint]] = limit.lower, limit.upper
    return JointLimits(limits["position"], limits["rate"], limits["effort"])


def _nonzero(limits: Array) -> Array:
    return np.asarray(limits[limits != 0.0])


def _has_bound(*limits: Array) -> bool:
    """Return whether any of the limits is a number instead of an infinity."""
    return any(bool((np.abs(values) < UNLIMITED).any()) for values in limits)


def limits_of_angle(angle: float) -> Array:
    """Return the limits (2, 4) of a ball's quaternion whose rotation has a largest angle [rad]."""
    limits = np.outer([-np.inf, np.inf], np.ones(4))
    if angle < np.pi:  # the largest angle of any rotation
        limits[0, 3] = np.cos(0.5 * angle)
    return limits


def angles_of_balls(system: System) -> dict[str, float]:
    """Return the largest angles of the balls that the robot's file bounds [rad]."""
    model, angles = system.sorted_model, dict[str, float]()
    for ball in system.space.balls:
        least = float(model.lowerPositionLimit[model.joints[model.getJointId(ball.name)].idx_q + 3])
        if 0.0 < least < 1.0:
            angles[ball.name] = 2.0 * float(np.arccos(least))
    return angles


def limits_of(system: System) -> tuple[StatedLimit, ...]:
    """Return the limits of joints with one rate, followers included; see `stated_limits`."""

    def make() -> tuple[StatedLimit, ...]:
        model, limits = system.sorted_model, list[StatedLimit]()
        for i in range(2, model.njoints):
            joint, name = model.joints[i], str(model.names[i])
            if joint.nv != 1:
                continue
            q, v = joint.idx_q, joint.idx_v
            low, high = float(model.lowerPositionLimit[q]), float(model.upperPositionLimit[q])
            if joint.nq == 1 and low <= high and (abs(low) < UNLIMITED or abs(high) < UNLIMITED):
                limits.append(StatedLimit(name, "position", low, high))
            most: dict[LimitKind, float] = {
                "rate": float(model.upperVelocityLimit[v]),
                "effort": float(model.upperEffortLimit[v]),
            }
            limits += [StatedLimit(name, k, -m, m) for k, m in most.items() if 0.0 < m < UNLIMITED]
        return tuple(limits)

    return once(nominal(system), StatedLimit, make)
