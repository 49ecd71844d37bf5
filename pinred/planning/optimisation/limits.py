"""Limits of joints, speeds and torques, and their accepted input formats."""

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

# A number r for [−r, r], or a pair, for all joints or by joint; speeds and torques accept r alone.
LimitsLike: TypeAlias = float | ArrayLike | Mapping[str, ArrayLike]
WHOLE_TURN = 2.0 * np.pi  # default limit of rotational joints, either way [rad]


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of the joints; infinite entries are no limits.

    Attributes:
        shape: Lower and upper bound, (m, 2) [rad | m].
        speed: Largest speed, (m,) [rad/s | m/s].
        torque: Largest torque or force, (m,) [N·m | N].
    """

    shape: Array
    speed: Array
    torque: Array

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def middle(self) -> Array:
        """Centre of the joint ranges, (m,)."""
        return np.asarray(self.shape.mean(axis=1))

    @property
    def reach(self) -> Array:
        """Half width of the joint ranges, (m,)."""
        return np.asarray(0.5 * np.ptp(self.shape, axis=1))


def limits_of(
    connection: Connection,
    shape: LimitsLike | None,
    speed: LimitsLike | None,
    torque: LimitsLike | None,
) -> Limits:
    """Convert options to limits.

    Args:
        connection: The connection.
        shape: Limits of the joints; None for the robot file, or a full turn either way.
        speed: Limits of the speeds, or None.
        torque: Limits of the torques, or None.
    Returns:
        The limits.
    Raises:
        InputError: A limit is invalid, or leaves no range.
        ShapeError: The number of limits is wrong.
    """
    m = connection.m
    defaults = _file_limits(connection)
    ranges = defaults if shape is None else _by_joint(connection, shape, "limits", defaults)
    for name, (low, high) in zip(connection.joints, ranges, strict=True):
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
            raise InputError(
                f"limits of joint '{name}' must be finite and increase, got [{low:g}, {high:g}]"
            )
    free = np.tile([-np.inf, np.inf], (m, 1))
    speeds = free if speed is None else _by_joint(connection, speed, "speeds", free)
    efforts = free if torque is None else _by_joint(connection, torque, "torques", free)
    return Limits(ranges, speeds[:, 1].copy(), efforts[:, 1].copy())


def _file_limits(connection: Connection) -> Array:
    """Return the ranges in the robot file, (m, 2); a full turn for rotations without range."""
    ranges = np.full((connection.m, 2), np.nan)
    for k, unit in enumerate(connection.form.units):
        if unit == "rad":
            ranges[k] = -WHOLE_TURN, WHOLE_TURN
    system = connection.system
    if system is not None:
        for k, joint in enumerate(system.joints):
            at = system.model.idx_qs[joint]
            if system.model.nqs[joint] == 1:
                low = float(system.model.lowerPositionLimit[at])
                high = float(system.model.upperPositionLimit[at])
                if np.isfinite([low, high]).all() and max(-low, high) < 1e6 and low < high:
                    ranges[k] = low, high
    return ranges


def _by_joint(connection: Connection, limits: LimitsLike, what: str, defaults: Array) -> Array:
    """Return pairs (m, 2) of limits; joints that are not named get `defaults`."""
    m = connection.m
    if isinstance(limits, Mapping):
        ranges = defaults.copy()
        for name, value in limits.items():
            ranges[joint_index(name, list(connection.joints), what)] = _pair(value, what)
        return ranges
    if isinstance(limits, (list, tuple)) and len(limits) == m:  # may mix numbers and pairs
        return np.stack([_pair(entry, what) for entry in limits])
    array = as_floats(limits, what)
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
