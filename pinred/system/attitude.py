"""Attitudes of ball joints as users write them: rotation vectors or quaternions."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..common.arrays import Array, as_floats, read_only
from ..common.errors import InputError
from ..common.names import brief
from ..lie.rotations import quaternion_exp


def attitude_of(value: Any, what: str) -> Array:
    """Return the unit quaternion (x, y, z, w) of an attitude.

    Args:
        value: Rotation vector, (3,) [rad], or quaternion (x, y, z, w) of any length.
        what: Name of the value in messages.
    Returns:
        The quaternion, (4,).
    Raises:
        InputError: The value is neither, is not finite, or is zero.
    """
    numbers = as_floats(value, what)
    if numbers.shape not in ((3,), (4,)) or not np.isfinite(numbers).all():
        raise InputError(
            f"{what}: expected a rotation vector of 3 finite numbers or a quaternion "
            f"(x, y, z, w), got {brief(value)}"
        )
    if numbers.shape == (3,):
        return read_only(quaternion_exp(numbers))
    length = float(np.linalg.norm(numbers))
    if not length > 0.0:
        raise InputError(f"{what}: expected a quaternion other than zero, got {brief(value)}")
    return read_only(numbers / length)
