"""Aims: what a loop is to do to the body, as functions of the phase with exact slopes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike

from ...common.arrays import Array, as_floats, freeze, vector
from ...common.errors import InputError
from ...common.plain_names import brief
from ...lie.group import Group
from ...lie.rotations import (
    conjugate,
    left_jacobian_inverse,
    quaternion_exp,
    quaternion_log,
    quaternion_product,
    unit,
)

AimKind: TypeAlias = Literal["rotation", "displacement", "target"]
AIMS: tuple[AimKind, ...] = get_args(AimKind)
_LETTERS = {"x": 0, "y": 1, "z": 2}


@dataclass(frozen=True, eq=False)
class Along:
    """As much as possible of a rotation about an axis, or of a displacement along one.

    rotation: the angle, unwrapped, where the group has one rotation; in space, the part along the
    axis of the rotation vector of a cycle [rad], at most π.  displacement: the part along the axis
    of the position after a cycle that turns the base by nothing [m]; with a turn, the base would
    go round in a circle, cycle after cycle.  axis: (turns,) or (linear,), a unit vector in the
    frame in which the base starts.
    """

    group: Group
    kind: AimKind
    axis: Array

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def unit(self) -> str:
        """The unit of the value."""
        return "rad" if self.kind == "rotation" else "m"

    def held(self, pose: Array) -> tuple[Array, Array]:
        """Return what must be zero (k,), and its slopes (k, r): the turn, of a displacement."""
        if self.kind == "rotation" or not self.group.turns:
            return np.zeros(0), np.zeros((0, self.group.dim))
        return Reach(self.group, self.group.identity()[self.group.linear :], None).missed(pose)

    def value(self, pose: Array) -> tuple[float, Array]:
        """Return the value at a pose and its slope (r,) by g⁻¹δg."""
        group, k = self.group, self.group.linear
        slope = np.zeros(group.dim)
        if self.kind == "displacement":
            slope[:k] = group.turned_back(pose[k:], self.axis)
            return float(self.axis @ pose[:k]), slope
        if group.turns == 1:
            slope[k] = self.axis[0]
            return float(self.axis[0] * pose[k]), slope
        w = quaternion_log(pose[k:])
        slope[k:] = self.axis @ left_jacobian_inverse(-w)
        return float(self.axis @ w), slope


@dataclass(frozen=True, eq=False)
class Reach:
    """A pose, or an attitude with any position.

    attitude: (size − linear,), an angle or a quaternion, or none.  position: (linear,) [m], or
    None if any will do.
    """

    group: Group
    attitude: Array
    position: Array | None

    def missed(self, pose: Array) -> tuple[Array, Array]:
        """Return what is missing (k,), rotation [rad] before position [m], and slopes (k, r)."""
        group, k = self.group, self.group.linear
        parts, slopes = [], []
        if group.turns:
            rows = np.zeros((group.turns, group.dim))
            if group.turns == 1:
                parts.append(pose[k:] - self.attitude)
                rows[0, k] = 1.0
            else:
                w = rotation_between(self.attitude, pose[k:])
                parts.append(w)
                rows[:, k:] = left_jacobian_inverse(-w)
            slopes.append(rows)
        if self.position is not None:
            parts.append(pose[:k] - self.position)
            rows = np.zeros((k, group.dim))
            for j, axis in enumerate(np.eye(k)):
                rows[j, :k] = group.turned_back(pose[k:], axis)
            slopes.append(rows)
        return np.concatenate(parts), np.vstack(slopes)


def rotation_between(a: Array, b: Array) -> Array:
    """Return the rotation vector of a⁻¹ b, (3,), of unit quaternions."""
    return quaternion_log(quaternion_product(conjugate(a), b))


def along(group: Group, kind: AimKind, axis: str | ArrayLike | None) -> Along:
    """Return the aim of a kind along an axis: a letter, a vector, or None for the only one.

    Raises InputError if the group does not move so, or has several axes and none is given.
    """
    size = group.turns if kind == "rotation" else group.linear
    if not size:
        raise InputError(f"the group {group.name} has no {kind}; its twists are {_names(group)}")
    if axis is None:
        if size > 1 and kind == "rotation":
            raise InputError("rotation in space needs an axis: 'x', 'y', 'z' or a vector (3,)")
        return Along(group, kind, np.eye(size)[0])
    own = group.axes[group.linear :] if kind == "rotation" else group.axes[: group.linear]
    if isinstance(axis, str):
        place = {
            letter: own.index(k + 3 * (kind == "rotation"))
            for letter, k in _LETTERS.items()
            if k + 3 * (kind == "rotation") in own
        }
        if axis not in place:
            raise InputError(f"axis must be {', '.join(place)} or a vector, got {brief(axis)}")
        return Along(group, kind, np.eye(size)[place[axis]])
    direction = vector(np.atleast_1d(as_floats(axis, "axis")), size, "axis")
    norm = float(np.linalg.norm(direction))
    if not norm > 0.0:
        raise InputError("axis must have a direction")
    return Along(group, kind, direction / norm)


def reach(group: Group, target: ArrayLike) -> Reach:
    """Return the aim of a target: a pose (size,), or the rotation alone, (turns,).

    Rotation: an angle [rad], which may be more than a turn, or a rotation vector [rad].
    Raises InputError or ShapeError for anything else.
    """
    given = np.atleast_1d(as_floats(getattr(target, "homogeneous", target), "target"))
    if group.turns and given.shape == (group.turns,):
        given = vector(given, group.turns, "target")
        turn = given.copy() if group.turns == 1 else quaternion_exp(given)
        return Reach(group, turn, None)
    pose = group.pose(given)
    if group.turns == 3:
        pose = np.concatenate([pose[:-4], unit(pose[-4:])])
    k = group.linear
    return Reach(group, pose[k:].copy(), pose[:k].copy() if k else None)


def _names(group: Group) -> str:
    return ", ".join(group.twist_names)
