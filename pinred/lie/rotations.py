"""Rotations in the plane and in space: closed forms that keep every digit.

Quaternions are (x, y, z, w), real part last.  Every function takes leading axes.
"""

from __future__ import annotations

import numpy as np

from ..common.arrays import Array

TAU = 2.0 * np.pi


def wrap(angle: Array) -> Array:
    """Return `angle` less the whole turns in it; small angles keep every digit."""
    return np.asarray(angle - TAU * np.rint(angle / TAU))


def hat(w: Array) -> Array:
    """Return the matrix of w × (…), (..., 3, 3)."""
    out = np.zeros((*w.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -w[..., 2], w[..., 1], -w[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = w[..., 2], -w[..., 1], w[..., 0]
    return out


def rotation(q: Array) -> Array:
    """Return the rotation matrix of unit quaternions (x, y, z, w), (..., 3, 3)."""
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
    """Return quaternions of any length as unit ones."""
    return np.asarray(q / np.linalg.norm(q, axis=-1, keepdims=True))


def sinc(angle: Array) -> Array:
    """Return sin(a)/a, exact at zero."""
    return np.asarray(np.sinc(angle / np.pi))


def quaternion_exp(w: Array) -> Array:
    """Return the quaternion of the rotation vector w [rad]."""
    half = 0.5 * np.linalg.norm(w, axis=-1, keepdims=True)
    return np.concatenate([0.5 * sinc(half) * w, np.cos(half)], axis=-1)


def quaternion_log(q: Array) -> Array:
    """Return the rotation vector of unit quaternions, of length at most π."""
    q = np.where(q[..., 3:] < 0.0, -q, q)  # q and −q are the same rotation; take the short way
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


def turning_matrix(w: Array) -> Array:
    """Return V(ω) of SE(3): exp(v, ω) has translation V v."""
    theta = np.linalg.norm(w, axis=-1)[..., None, None]
    t2 = theta**2
    small = theta < 0.1
    safe = np.where(small, 1.0, theta)
    # The series is at round-off below 0.1; the closed form loses digits there.
    c2 = np.where(
        small,
        1 / 6 - t2 / 120 * (1 - t2 / 42 * (1 - t2 / 72)),
        (safe - np.sin(safe)) / safe**3,
    )
    H = hat(w)
    return np.asarray(np.eye(3) + 0.5 * sinc(0.5 * theta) ** 2 * H + c2 * (H @ H))


def turning_inverse(w: Array) -> Array:
    """Return V(ω)⁻¹ of SE(3), for |ω| ≤ π."""
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
    """Return the matrix of a turn by θ in the plane, (..., 2, 2)."""
    c, s = np.cos(theta), np.sin(theta)
    return np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)


def apply(matrix: Array, vector: Array) -> Array:
    """Return matrix @ vector for stacks of both."""
    return np.asarray(matrix @ vector[..., None])[..., 0]


def homogeneous(R: Array, p: Array) -> Array:
    """Return [[R, p], [0, 1]]."""
    k = p.shape[-1]
    out = np.zeros((*p.shape[:-1], k + 1, k + 1))
    out[..., :k, :k], out[..., :k, k], out[..., k, k] = R, p, 1.0
    return out


def quaternion_of(matrix: Array) -> Array:
    """Return the quaternions of rotation matrices."""
    from scipy.spatial.transform import Rotation  # heavy to import, used only for matrices

    return np.asarray(Rotation.from_matrix(matrix).as_quat())
