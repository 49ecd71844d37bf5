"""Functions for rotations in the plane and in space, accurate to round-off.

Quaternions are (x, y, z, w), real part last.  All functions accept leading axes.
"""

from __future__ import annotations

import numpy as np

from ..common.arrays import Array

TAU = 2.0 * np.pi
_TINY = 1e-300


def wrap(angle: Array) -> Array:
    """Reduce an angle [rad] to [−π, π]; angles already in this range stay exact."""
    return np.asarray(angle - TAU * np.rint(angle / TAU))


def hat(w: Array) -> Array:
    """Return the skew-symmetric matrix of the cross product w × (…), (..., 3, 3)."""
    matrix = np.zeros((*w.shape[:-1], 3, 3))
    matrix[..., 0, 1], matrix[..., 0, 2], matrix[..., 1, 2] = -w[..., 2], w[..., 1], -w[..., 0]
    matrix[..., 1, 0], matrix[..., 2, 0], matrix[..., 2, 1] = w[..., 2], -w[..., 1], w[..., 0]
    return matrix


def rotation(q: Array) -> Array:
    """Return the rotation matrices of unit quaternions (x, y, z, w), (..., 3, 3)."""
    u, w = q[..., :3], q[..., 3, None, None]
    H = hat(u)
    return np.asarray(np.eye(3) + 2.0 * (w * H + H @ H))


def quaternion_product(a: Array, b: Array) -> Array:
    """Return the Hamilton product of quaternions (x, y, z, w)."""
    u, s, v, t = a[..., :3], a[..., 3:], b[..., :3], b[..., 3:]
    return np.concatenate(
        [s * v + t * u + np.cross(u, v), s * t - np.sum(u * v, axis=-1, keepdims=True)], axis=-1
    )


def conjugate(q: Array) -> Array:
    """Return the inverse of unit quaternions."""
    return np.asarray(q * np.array([-1.0, -1.0, -1.0, 1.0]))


def unit(q: Array) -> Array:
    """Scale quaternions to unit norm."""
    return np.asarray(q / np.linalg.norm(q, axis=-1, keepdims=True))


def sinc(angle: Array) -> Array:
    """Return sin(a)/a, with the limit 1 at zero."""
    return np.asarray(np.sinc(angle / np.pi))


def quaternion_exp(w: Array) -> Array:
    """Return the quaternion of the rotation vector w [rad]."""
    half = 0.5 * np.linalg.norm(w, axis=-1, keepdims=True)
    return np.concatenate([0.5 * sinc(half) * w, np.cos(half)], axis=-1)


def quaternion_log(q: Array) -> Array:
    """Return the rotation vectors of unit quaternions, with norm at most π [rad]."""
    q = np.where(q[..., 3:] < 0.0, -q, q)  # q and −q are the same rotation; use the smaller angle
    n = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    w = q[..., 3:]
    small = n < 1e-4
    safe = np.where(small, 1.0, n)
    factor = np.where(
        small,
        (2.0 - 2.0 / 3.0 * (n / np.where(small, w, 1.0)) ** 2) / np.where(small, w, 1.0),
        2.0 * np.arctan2(n, w) / safe,
    )
    return np.asarray(factor * q[..., :3])


def unwrapped_rotation_vectors(q: Array) -> Array:
    """Return continuous rotation vectors, (T, 3) [rad], of unit quaternions over time, (T, 4).

    The first vector has a norm of at most π.  Each further vector is the one closest to the vector
    before, among those whose norms differ by full turns.
    """
    vectors = quaternion_log(q)
    for k in range(1, len(vectors)):
        vectors[k] = closest_rotation_vectors(q[k], vectors[k - 1])
    return vectors


def closest_rotation_vectors(q: Array, near: Array) -> Array:
    """Return the rotation vectors, (..., 3), of unit quaternions, (..., 4), closest to others.

    The vectors of one rotation differ by full turns about its axis; without rotation, the axis is
    that of `near`, (..., 3).
    """
    w = quaternion_log(q)
    angle = np.linalg.norm(w, axis=-1, keepdims=True)
    length = np.linalg.norm(near, axis=-1, keepdims=True)
    axis = np.where(angle > 0.0, w, near) / np.where(angle > 0.0, angle, np.maximum(length, _TINY))
    turns = np.rint((np.sum(near * axis, axis=-1, keepdims=True) - angle) / TAU)
    return np.asarray((angle + TAU * turns) * axis)


def left_jacobian(w: Array) -> Array:
    """Return the left Jacobian V(ω) of SO(3): exp(v, ω) in SE(3) has translation V v."""
    theta = np.linalg.norm(w, axis=-1)[..., None, None]
    t2 = theta**2
    small = theta < 0.1
    safe = np.where(small, 1.0, theta)
    # Below 0.1 rad use the series, which is accurate to round-off; the closed form loses digits.
    c2 = np.where(
        small,
        1 / 6 - t2 / 120 * (1 - t2 / 42 * (1 - t2 / 72)),
        (safe - np.sin(safe)) / safe**3,
    )
    H = hat(w)
    return np.asarray(np.eye(3) + 0.5 * sinc(0.5 * theta) ** 2 * H + c2 * (H @ H))


def left_jacobian_inverse(w: Array) -> Array:
    """Return the inverse of the left Jacobian of SO(3), V(ω)⁻¹, for |ω| ≤ π."""
    theta = np.linalg.norm(w, axis=-1)[..., None, None]
    t2 = theta**2
    small = theta < 0.1
    half = 0.5 * np.where(small, 1.0, theta)
    c = np.where(
        small,
        1 / 12 + t2 / 720 * (1 + t2 / 42 * (1 + t2 / 40)),
        (1.0 - np.cos(half) / sinc(half)) / np.where(small, 1.0, t2),
    )
    H = hat(w)
    return np.asarray(np.eye(3) - 0.5 * H + c * (H @ H))


def plane_rotation(theta: Array) -> Array:
    """Return the matrix of a plane rotation by θ [rad], (..., 2, 2)."""
    c, s = np.cos(theta), np.sin(theta)
    return np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)


def apply(matrix: Array, vector: Array) -> Array:
    """Return matrix @ vector for arrays with equal leading axes."""
    return np.asarray(matrix @ vector[..., None])[..., 0]


def homogeneous(R: Array, p: Array) -> Array:
    """Return the homogeneous matrix [[R, p], [0, 1]]."""
    k = p.shape[-1]
    matrix = np.zeros((*p.shape[:-1], k + 1, k + 1))
    matrix[..., :k, :k], matrix[..., :k, k], matrix[..., k, k] = R, p, 1.0
    return matrix


def quaternion_from_matrix(matrix: Array) -> Array:
    """Return the quaternions of rotation matrices."""
    # Import here, because the import is slow and rarely needed.
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(matrix).as_quat())
