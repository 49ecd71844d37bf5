"""A body of a described robot, with the joint that carries it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from ..common.arrays import Array, as_floats, positive, read_only, vector
from ..common.errors import InputError, ShapeError
from ..common.names import brief, quoted

BodyJoint: TypeAlias = Literal["", "hinge", "slide", "ball", "fixed"]

_AXES = dict(zip("xyz", np.eye(3), strict=True))


@dataclass(frozen=True, eq=False)
class DescribedBody:
    """A body with the joint that carries it.

    Attributes:
        name: Name of the body and of its joint.
        mass: Mass [kg].
        inertia: Moment of inertia about the centre of mass, (3, 3), in the body's axes [kg m²].
        com: Centre of mass in the body frame, (3,) [m].
        joint: Type of the joint; "" for the base.
        parent: Name of the body that carries the joint; "" for the base.
        axis: Unit axis of a hinge or slide in the body's axes, (3,).
        at: Origin of the body frame in the parent's frame where the joint is at zero, (3,) [m].
        attitude: Attitude of the body relative to its parent, as a quaternion (x, y, z, w).
        limits: Lowest and highest value of a hinge or slide [rad | m], or None.
    """

    name: str
    mass: float
    inertia: Array
    com: Array
    joint: BodyJoint
    parent: str
    axis: Array
    at: Array
    attitude: Array
    limits: tuple[float, float] | None


def inertia_matrix(value: ArrayLike, what: str) -> Array:
    """Return a symmetric inertia matrix, (3, 3)."""
    given = as_floats(value, f"inertia of {what}")
    if given.shape not in ((), (3,), (3, 3)):
        raise ShapeError(
            f"inertia of {what}: expected one number, three principal moments or a matrix (3, 3), "
            f"got shape {given.shape}"
        )
    matrix = given if given.ndim == 2 else np.diag(np.broadcast_to(given, 3))
    if not np.isfinite(matrix).all() or not np.array_equal(matrix, matrix.T):
        raise InputError(f"inertia of {what} must be finite and symmetric, got {brief(value)}")
    return read_only(np.array(matrix))


def unit_axis(value: str | ArrayLike, what: str) -> Array:
    """Return a unit vector from the name of an axis or from a vector."""
    if isinstance(value, str):
        name = value.removeprefix("-")
        if name not in _AXES:
            raise InputError(
                f"axis of {what} must be x, y, z, -x, -y, -z or a vector, got {quoted(value)}"
            )
        return read_only(-_AXES[name] if value[0] == "-" else _AXES[name].copy())
    given = vector(value, 3, f"axis of {what}")
    length = float(np.linalg.norm(given))
    if length == 0.0:
        raise InputError(f"axis of {what} must not be zero")
    return read_only(given / length)


def checked_mass(mass: float, inertia: Array, com: Array, joint: str, what: str) -> float:
    """Return the mass of a body.  A body on a fixed joint may be a frame without mass."""
    if joint == "fixed" and isinstance(mass, (int, float)) and mass == 0:
        if inertia.any() or com.any():
            raise InputError(f"{what}: a frame without mass has neither inertia nor com")
        return 0.0
    return positive(mass, f"mass of {what}")


def increasing_limits(value: tuple[float, float] | None, what: str) -> tuple[float, float] | None:
    """Return increasing limits, or None."""
    if value is None:
        return None
    low, high = vector(value, 2, f"limits of {what}")
    if low >= high:
        raise InputError(f"limits of {what} must increase, got {brief(value)}")
    return float(low), float(high)
