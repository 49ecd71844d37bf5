"""Euler angles of a floating base, for tools whose joints have one degree of freedom.

A rotation is R = R₁(θ₁) R₂(θ₂) R₃(θ₃) about the axes x, y, z in some order. Of the six orders,
`best_order` selects the order whose singularity cos θ₂ = 0 is farthest from the motion.
"""

from __future__ import annotations

import numpy as np

from ....common.arrays import Array
from ..problems import Problem

Order = tuple[int, int, int]
ORDERS: tuple[Order, ...] = ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0))
_SAMPLES = 400  # number of times at which the motion is evaluated


def rotation_about(axis: int, angle: float) -> Array:
    """Return the rotation matrix about x, y or z (axis 0, 1 or 2)."""
    R = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R[i, i] = R[j, j] = np.cos(angle)
    R[j, i] = np.sin(angle)
    R[i, j] = -R[j, i]
    return R


def angles_of(R: Array, order: Order) -> Array:
    """Compute the three angles of a rotation matrix, the second in [−π/2, π/2]."""
    i, j, k = order
    sign = 1.0 if (j - i) % 3 == 1 else -1.0
    return np.array(
        [
            np.arctan2(-sign * R[j, k], R[k, k]),
            np.arcsin(np.clip(sign * R[i, k], -1.0, 1.0)),
            np.arctan2(-sign * R[i, j], R[i, i]),
        ]
    )


def rotation_of(angles: Array, order: Order) -> Array:
    """Compute the rotation matrix of three angles."""
    first, second, third = (rotation_about(a, t) for a, t in zip(order, angles, strict=True))
    return np.asarray(first @ second @ third)


def spin_matrix(angles: Array, order: Order) -> Array:
    """Compute the matrix (3, 3) that maps angle rates to the body's angular velocity."""
    third = rotation_about(order[2], angles[2]).T
    second = third @ rotation_about(order[1], angles[1]).T
    unit = np.eye(3)
    return np.column_stack([second @ unit[order[0]], third @ unit[order[1]], unit[order[2]]])


def spin_rate(angles: Array, rates: Array, order: Order) -> Array:
    """Compute the time derivative of the spin matrix times the angle rates, (3,)."""
    E = spin_matrix(angles, order)
    last = E[:, 2] * rates[2]
    last_two = last + E[:, 1] * rates[1]
    return np.asarray(-np.cross(last_two, E[:, 0]) * rates[0] - np.cross(last, E[:, 1]) * rates[1])


def best_order(problem: Problem) -> Order:
    """Return the order of axes whose singularity is farthest from the motion."""
    times = np.linspace(0.0, problem.start.duration, _SAMPLES)[1:]
    motion = problem.full.run(problem.full_start(), times, 1e-6, 1e-8)
    group = problem.system.group
    poses = problem.system.configuration(motion.q).pose
    k = group.linear
    R = np.array([group.matrix(pose)[:3, :3] for pose in poses]) if k + 4 == group.size else None
    if R is None:
        return ORDERS[0]
    return min(ORDERS, key=lambda order: float(np.abs(R[:, order[0], order[2]]).max()))
