"""Objectives of a loop: functions of the final pose with exact derivatives."""

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
class AxisAim:
    """A rotation about an axis, or a displacement along one, to be maximised.

    The rotation of a planar group is the unwrapped angle [rad].  In space it is the component of
    the rotation vector along the axis, at most π.  A displacement is the component of the final
    position along the axis [m].  It requires a zero rotation, because otherwise repeated cycles
    would move the base in a circle.

    Attributes:
        group: The symmetry group.
        kind: "rotation" or "displacement".
        axis: Unit vector in the initial frame of the base, (turns,) or (linear,).
    """

    group: Group
    kind: AimKind
    axis: Array

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def unit(self) -> str:
        """Unit of the value."""
        return "rad" if self.kind == "rotation" else "m"

    def constraint(self, pose: Array) -> tuple[Array, Array]:
        """Compute the equality constraints: a displacement requires zero rotation.

        Args:
            pose: Pose after one cycle, (size,).
        Returns:
            The constraint values, (k,), and their derivatives by g⁻¹δg, (k, r).
        """
        if self.kind == "rotation" or not self.group.turns:
            return np.zeros(0), np.zeros((0, self.group.dim))
        return TargetAim(self.group, self.group.identity()[self.group.linear :], None).error(pose)

    def value(self, pose: Array) -> tuple[float, Array]:
        """Compute the value.

        Args:
            pose: Pose after one cycle, (size,).
        Returns:
            The value and its derivative by g⁻¹δg, (r,).
        """
        group, k = self.group, self.group.linear
        derivative = np.zeros(group.dim)
        if self.kind == "displacement":
            derivative[:k] = group.turned_back(pose[k:], self.axis)
            return float(self.axis @ pose[:k]), derivative
        if group.turns == 1:
            derivative[k] = self.axis[0]
            return float(self.axis[0] * pose[k]), derivative
        w = quaternion_log(pose[k:])
        derivative[k:] = self.axis @ left_jacobian_inverse(-w)
        return float(self.axis @ w), derivative


@dataclass(frozen=True, eq=False)
class TargetAim:
    """A pose, or an attitude with any position, to be reached.

    Attributes:
        group: The symmetry group.
        attitude: Angle [rad] or unit quaternion, (size − linear,).
        position: Position, (linear,) [m], or None for any position.
    """

    group: Group
    attitude: Array
    position: Array | None

    def error(self, pose: Array) -> tuple[Array, Array]:
        """Compute the deviation from the target.

        Args:
            pose: Pose after one cycle, (size,).
        Returns:
            The deviation, (k,), rotation [rad] before position [m], and its derivatives by g⁻¹δg,
            (k, r).
        """
        group, k = self.group, self.group.linear
        errors, derivatives = [], []
        if group.turns:
            by_twist = np.zeros((group.turns, group.dim))
            if group.turns == 1:
                errors.append(pose[k:] - self.attitude)
                by_twist[0, k] = 1.0
            else:
                w = rotation_between(self.attitude, pose[k:])
                errors.append(w)
                by_twist[:, k:] = left_jacobian_inverse(-w)
            derivatives.append(by_twist)
        if self.position is not None:
            errors.append(pose[:k] - self.position)
            by_twist = np.zeros((k, group.dim))
            for j, axis in enumerate(np.eye(k)):
                by_twist[j, :k] = group.turned_back(pose[k:], axis)
            derivatives.append(by_twist)
        return np.concatenate(errors), np.vstack(derivatives)


def rotation_between(a: Array, b: Array) -> Array:
    """Return the rotation vector of a⁻¹ b, (3,), for unit quaternions."""
    return quaternion_log(quaternion_product(conjugate(a), b))


def axis_aim(group: Group, kind: AimKind, axis: str | ArrayLike | None) -> AxisAim:
    """Create the objective along or about an axis.

    Args:
        group: The symmetry group.
        kind: "rotation" or "displacement".
        axis: 'x', 'y', 'z', a vector, or None for the first or only axis.
    Returns:
        The objective.
    Raises:
        InputError: The group has no such motion, or the axis is missing or invalid.
    """
    size = group.turns if kind == "rotation" else group.linear
    if not size:
        raise InputError(f"the group {group.name} has no {kind}; its twists are {_names(group)}")
    if axis is None:
        if size > 1 and kind == "rotation":
            raise InputError("rotation in space needs an axis: 'x', 'y', 'z' or a vector (3,)")
        return AxisAim(group, kind, np.eye(size)[0])
    axes = group.axes[group.linear :] if kind == "rotation" else group.axes[: group.linear]
    if isinstance(axis, str):
        indices = {
            letter: axes.index(k + 3 * (kind == "rotation"))
            for letter, k in _LETTERS.items()
            if k + 3 * (kind == "rotation") in axes
        }
        if axis not in indices:
            raise InputError(f"axis must be {', '.join(indices)} or a vector, got {brief(axis)}")
        return AxisAim(group, kind, np.eye(size)[indices[axis]])
    direction = vector(np.atleast_1d(as_floats(axis, "axis")), size, "axis")
    norm = float(np.linalg.norm(direction))
    if not norm > 0.0:
        raise InputError(f"axis: expected a nonzero vector, got {brief(axis)}")
    return AxisAim(group, kind, direction / norm)


def target_aim(group: Group, target: ArrayLike) -> TargetAim:
    """Create the objective of a target.

    Args:
        group: The symmetry group.
        target: A pose, (size,), or a rotation, (turns,): an angle [rad], which may exceed a full
            turn, or a rotation vector [rad].
    Returns:
        The objective.
    Raises:
        InputError: The target is not in the group.
        ShapeError: The target has another shape, or is not finite.
    """
    values = np.atleast_1d(as_floats(getattr(target, "homogeneous", target), "target"))
    if group.turns and values.shape == (group.turns,):
        values = vector(values, group.turns, "target")
        attitude = values.copy() if group.turns == 1 else quaternion_exp(values)
        return TargetAim(group, attitude, None)
    pose = group.pose(values)
    if group.turns == 3:
        pose = np.concatenate([pose[:-4], unit(pose[-4:])])
    k = group.linear
    return TargetAim(group, pose[k:].copy(), pose[:k].copy() if k else None)


def _names(group: Group) -> str:
    return ", ".join(group.twist_names)
