"""Joint values by name: a table {joint: value} as an array in the order of the shape.

The value of a hinge or slide is a number.  The attitude of a ball is a rotation vector of three
numbers [rad] or a quaternion (x, y, z, w); its rate is the angular velocity of the child relative
to the parent, in the child's axes.  The same table serves Python, the command line and files.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..common.arrays import Array, as_floats, read_only
from ..common.errors import InputError, ShapeError
from ..common.names import joint_index
from ..lie.rotations import quaternion_exp
from ..system.coordinates import PlacedJoint
from ..system.system import System

_RATES = "xdot0"  # option whose values are rates; all other options are shapes


def order_by_joint(value: Any, system: System, what: str) -> Any:
    """Convert values by joint name to one array in the order of the shape.

    Args:
        value: {joint: number}, or {joint: (N,) numbers} for N members; entries of balls have a
            last axis of three or four.  Axes of balls may be named on their own, such as
            "neck.x".  Any value that is not a mapping is returned unchanged.
        system: System with the joints.
        what: Name of the option: "xdot0" for rates, any other name for shapes.
    Returns:
        (nx,) or (N, nx) for shapes, (m,) or (N, m) for rates; joints that are not named are at
        rest.
    Raises:
        InputError: A joint does not exist or is a follower, or a quaternion is zero.
        ShapeError: The lengths differ, or the value of a ball has a wrong number of entries.
    """
    if not isinstance(value, Mapping):
        return value
    space, of_shape = system.space, what != _RATES
    labels = space.x_names if of_shape else space.names
    balls = {joint.name: joint for joint in space.balls}
    columns: dict[tuple[int, int], Array] = {}
    for name, entry in value.items():
        system.refuse_follower(name, what)
        numbers = as_floats(entry, f"{what}['{name}']")
        if name in balls:
            columns[_place(balls[name], of_shape)] = _of_ball(numbers, balls[name], what)
            continue
        if name not in labels:
            # Ball joints are valid names as well.
            joint_index(name, [joint.name for joint in space.joints], what)
        k = labels.index(name)
        columns[k, k + 1] = numbers[..., None]
    _refuse_parts(balls, columns, what)
    leading = {column.shape[:-1] for column in columns.values()} - {()}
    if len(leading) > 1 or any(len(shape) > 1 for shape in leading):
        raise ShapeError(
            f"{what} must have a number for each joint, or as many for each as there are "
            f"members, got shapes {', '.join(map(str, sorted(leading)))}"
        )
    array = np.zeros((*(leading.pop() if leading else ()), len(labels)))
    if of_shape:
        array[:] = space.neutral
    for (first, last), column in columns.items():
        array[..., first:last] = column
    return read_only(array)


def _place(joint: PlacedJoint, of_shape: bool) -> tuple[int, int]:
    """Return the first entry of a joint and the entry after its last."""
    entries = joint.x if of_shape else joint.v
    return entries.start, entries.stop


def _of_ball(numbers: Array, joint: PlacedJoint, what: str) -> Array:
    """Return the quaternion, (..., 4), or the rates, (..., 3), of a ball."""
    widths: Sequence[int] = (3,) if what == _RATES else (3, 4)
    if numbers.ndim == 0 or numbers.shape[-1] not in widths:
        expected = "a rotation vector of 3 numbers or a quaternion (x, y, z, w)"
        if what == _RATES:
            expected = "an angular velocity of 3 numbers, in the axes of the child"
        raise ShapeError(
            f"{what}['{joint.name}'] is a ball joint: expected {expected}, got shape "
            f"{numbers.shape}"
        )
    if not np.isfinite(numbers).all():
        raise ShapeError(f"{what}['{joint.name}'] must be finite, got {numbers}")
    if what == _RATES:
        return numbers
    if numbers.shape[-1] == 3:
        return quaternion_exp(numbers)
    length = np.linalg.norm(numbers, axis=-1, keepdims=True)
    if not (length > 0.0).all():
        raise InputError(
            f"{what}['{joint.name}']: the quaternion of a ball joint must not be zero; "
            "the joint at rest is (0, 0, 0, 1)"
        )
    return np.asarray(numbers / length)


def _refuse_parts(
    balls: Mapping[str, PlacedJoint], columns: Mapping[tuple[int, int], Array], what: str
) -> None:
    """Reject a table that sets the same entries twice or only some entries of a quaternion."""
    for name, joint in balls.items():
        whole = first, last = _place(joint, what != _RATES)
        parts = [p for p in columns if p != whole and first <= p[0] < last]
        if parts and (whole in columns or what != _RATES):
            raise InputError(
                f"{what}: set joint '{name}' as a whole, as {what}={{'{name}': …}}, not by its "
                "entries"
            )
