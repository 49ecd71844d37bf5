"""Limits of joints, of their speeds and of their torques, in the forms that options may have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from ...analysis.connections.connection import Connection
from ...common.arrays import Array, as_floats, freeze
from ...common.errors import InputError, ShapeError
from ...common.names import joint_index

# One for all joints, or by joint: a number r for [−r, r], or a pair; of speeds and torques, r.
LimitsLike: TypeAlias = float | ArrayLike | Mapping[str, ArrayLike]
WHOLE_TURN = 2.0 * np.pi  # rad; how far a joint without limits may go, either way


@dataclass(frozen=True, eq=False)
class Limits:
    """What joints may do.

    shape: (m, 2) least and greatest value [rad | m].  speed: (m,) [rad/s | m/s].  torque: (m,)
    [N m | N].  Infinite where there is no limit.
    """

    shape: Array
    speed: Array
    torque: Array

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def middle(self) -> Array:
        """Middle of what the joints may do, (m,)."""
        return np.asarray(self.shape.mean(axis=1))

    @property
    def reach(self) -> Array:
        """Half of what the joints may move through, (m,)."""
        return np.asarray(0.5 * np.ptp(self.shape, axis=1))


def limits_of(
    connection: Connection,
    shape: LimitsLike | None,
    speed: LimitsLike | None,
    torque: LimitsLike | None,
) -> Limits:
    """Return limits as options give them.

    shape: None for those in the robot's file, and where it has none a whole turn either way.
    Raises InputError or ShapeError for limits that are none, or that leave nothing to move.
    """
    m = connection.m
    own = _in_the_file(connection)
    ranges = own if shape is None else _by_joint(connection, shape, "limits", own)
    for name, (low, high) in zip(connection.joints, ranges, strict=True):
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
            raise InputError(
                f"limits of joint '{name}' must be finite and increase, got [{low:g}, {high:g}]"
            )
    free = np.tile([-np.inf, np.inf], (m, 1))
    speeds = free if speed is None else _by_joint(connection, speed, "speeds", free)
    efforts = free if torque is None else _by_joint(connection, torque, "torques", free)
    return Limits(ranges, speeds[:, 1].copy(), efforts[:, 1].copy())


def _in_the_file(connection: Connection) -> Array:
    """Return what the file says of each joint, (m, 2); a whole turn where it says nothing."""
    out = np.full((connection.m, 2), np.nan)
    for k, unit in enumerate(connection.form.units):
        if unit == "rad":
            out[k] = -WHOLE_TURN, WHOLE_TURN
    system = connection.system
    if system is not None:
        for k, joint in enumerate(system.joints):
            at = system.model.idx_qs[joint]
            if system.model.nqs[joint] == 1:
                low = float(system.model.lowerPositionLimit[at])
                high = float(system.model.upperPositionLimit[at])
                if np.isfinite([low, high]).all() and max(-low, high) < 1e6 and low < high:
                    out[k] = low, high
    return out


def _by_joint(connection: Connection, given: LimitsLike, what: str, own: Array) -> Array:
    """Return pairs (m, 2) of limits; those not named are `own`."""
    m = connection.m
    if isinstance(given, Mapping):
        out = own.copy()
        for name, value in given.items():
            out[joint_index(name, list(connection.joints), what)] = _pair(value, what)
        return out
    if isinstance(given, (list, tuple)) and len(given) == m:  # numbers and pairs, mixed, too
        return np.stack([_pair(entry, what) for entry in given])
    array = as_floats(given, what)
    if array.ndim == 0:
        return np.tile(_pair(array, what), (m, 1))
    if array.shape == (m,) or (what == "limits" and array.shape == (m, 2)):
        return np.stack([_pair(entry, what) for entry in array])
    raise ShapeError(
        f"{what} must be a number, one for each of {m} joints, or {{joint: limit}}"
        f"{', or pairs (m, 2)' if what == 'limits' else ''}; got shape {array.shape}"
    )


def _pair(value: ArrayLike, what: str) -> Array:
    array = as_floats(value, what)
    if array.shape == (2,) and what == "limits":
        return array
    if array.ndim or not array > 0.0:
        raise InputError(f"{what} of a joint must be above zero, or a pair, got {value!r}")
    return np.array([-float(array), float(array)])
