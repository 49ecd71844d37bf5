"""Coordinates of the full state: the root joint, and Pinocchio's configuration q.

The root joint is described by Pinocchio's motion subspace alone, independent of pinred's groups.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin, sqrt

import numpy as np
import pinocchio as pin

from ..common.arrays import Array


@dataclass(frozen=True)
class RootMotion:
    """Kinematics of the root joint of a model.

    Attributes:
        axes: Motion subspace in the joint's fixed frame, (6, r), translations first.
        linear: Number of translational directions.
        turns: Number of rotational directions.
        plane: The two translations that a single rotation mixes (planar joint), or None.
        circle: Whether Pinocchio stores the angle as cosine and sine.
    """

    axes: Array
    linear: int
    turns: int
    plane: tuple[int, int] | None
    circle: bool

    @property
    def size(self) -> int:
        """Number of root coordinates: positions, then the angle or the quaternion."""
        return self.linear + (4 if self.turns == 3 else self.turns)

    @property
    def is_pivoted(self) -> bool:
        """Whether the base rotates about a fixed point, so momentum is taken about that point."""
        slides_across = self.plane is not None or (self.turns == 3 and self.linear == 3)
        return self.turns > 0 and not slides_across

    def rate(self, root: list[float], v: list[float]) -> list[float]:
        """Compute the time derivative of the root coordinates (size,) at a body twist v (r,).

        Scalar arithmetic is four times as fast as numpy on arrays of three numbers.
        """
        if self.turns < 3:
            if self.plane is None:
                return v
            rate, (i, j) = v.copy(), self.plane
            c, s = cos(root[-1]), sin(root[-1])
            rate[i], rate[j] = c * v[i] - s * v[j], s * v[i] + c * v[j]
            return rate
        i, j, k, w = root[-4:]
        *slide, p, q, s = v
        quaternion_rate = [
            0.5 * (w * p + j * s - k * q),
            0.5 * (w * q + k * p - i * s),
            0.5 * (w * s + i * q - j * p),
            -0.5 * (i * p + j * q + k * s),
        ]
        if not slide:
            return quaternion_rate
        a, b, c = slide  # body translation, to be rotated by the matrix 1 + 2 (w ω̂ + ω̂²) / |q|²
        two = 2.0 / (i * i + j * j + k * k + w * w)
        l, m, n = two * (j * c - k * b), two * (k * a - i * c), two * (i * b - j * a)
        return [
            a + w * l + j * n - k * m,
            b + w * m + k * l - i * n,
            c + w * n + i * m - j * l,
            *quaternion_rate,
        ]

    def q(self, root: Array) -> Array:
        """Convert root coordinates (size,) to Pinocchio's configuration of the joint."""
        if self.circle:
            *slide, angle = root.tolist()
            return np.array([*slide, cos(angle), sin(angle)])
        q = root.copy()
        if self.turns == 3:
            quaternion = q[-4:]
            quaternion /= sqrt(quaternion.dot(quaternion))  # `@` takes twice as long
        return q


def root_motion(model: pin.Model) -> RootMotion:
    """Derive the kinematics of the root joint of a model."""
    joint, single_joint = model.joints[1], pin.Model()
    single_joint.addJoint(0, joint, pin.SE3.Identity(), "alone")
    data = single_joint.createData()
    pin.computeJointJacobians(single_joint, data, pin.neutral(single_joint))
    axes = np.array(data.joints[1].S).reshape(6, joint.nv)
    linear = int((~axes[3:].any(axis=0)).sum())
    turns = joint.nv - linear
    plane = _mixed_translations(axes, linear) if turns == 1 else None
    return RootMotion(axes, linear, turns, plane, circle=turns == 1 and joint.nq > joint.nv)


def _mixed_translations(axes: Array, linear: int) -> tuple[int, int] | None:
    """Return the two translations that the single rotation of a root joint mixes, if any."""
    rotated = np.cross(axes[3:, -1], axes[:3, :linear], axis=0)
    overlap = axes[:3, :linear].T @ rotated  # (i, j): component of rotated axis j along axis i
    pairs = np.argwhere(overlap > 0.5)
    return (int(pairs[0, 1]), int(pairs[0, 0])) if pairs.size else None


class Configuration:
    """Map from root coordinates and unwrapped joint values to Pinocchio's configuration q."""

    def __init__(self, model: pin.Model, root: RootMotion) -> None:
        """Split the joints by whether Pinocchio stores their angle as cosine and sine."""
        joints, first = list(model.joints[2:]), model.joints[1].nq
        circles = np.array([joint.nq == 2 for joint in joints], dtype=bool)
        offsets = np.array([joint.idx_q for joint in joints], dtype=np.intp)
        self._root, self._has_circles = root, bool(circles.any())
        self._circles = np.flatnonzero(circles)
        # Index of each entry of q in (q of the root, joint values, cosines, sines).
        self._order = np.arange(model.nq)
        self._order[offsets] = first + np.arange(len(joints))
        cosines = first + len(joints) + np.arange(len(self._circles))
        self._order[offsets[circles]] = cosines
        self._order[offsets[circles] + 1] = cosines + len(cosines)

    def __call__(self, root: Array, joints: Array) -> Array:
        """Return q (nq,) for root coordinates (size,) and the values of all joints (M,)."""
        root_q = self._root.q(root)
        if not self._has_circles:
            return np.concatenate((root_q, joints))
        angles = joints[self._circles]
        parts = root_q, joints, np.cos(angles), np.sin(angles)
        return np.asarray(np.concatenate(parts)[self._order])
