"""Coordinates of the full state: the root joint, and Pinocchio's configuration q.

All functions accept arrays of symbols, too, which rate_terms.py compiles.

The root joint is described by Pinocchio's motion subspace alone, independent of pinred's groups.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

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

    def rate(self, root: Array, v: Array) -> Sequence[Any] | Array:
        """Compute the time derivative of the root coordinates (size,) at a body twist v (r,).

        Args:
            root: Root coordinates, (size,), numbers or symbols.
            v: Body twist, (r,).
        Returns:
            The time derivative, (size,).
        """
        if self.turns < 3:
            if self.plane is None:
                return v
            rate, (first, second) = list(v), self.plane
            (c,), (s,) = np.cos(root[-1:]), np.sin(root[-1:])
            rate[first] = c * v[first] - s * v[second]
            rate[second] = s * v[first] + c * v[second]
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
        """Convert root coordinates (..., size) to Pinocchio's configuration of the joint."""
        if self.circle:
            angle = root[..., -1:]
            return np.concatenate((root[..., :-1], np.cos(angle), np.sin(angle)), axis=-1)
        q = root.copy()
        if self.turns == 3:
            normalise(q[..., -4:])
        return q


def normalise(quaternions: Array) -> None:
    """Divide quaternions (..., 4), of numbers or symbols, by their norms, in place."""
    quaternions /= np.sqrt((quaternions * quaternions).sum(axis=-1, keepdims=True))


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
    """Coordinates of all joints except the root, and their map to Pinocchio's configuration q.

    A joint has one unwrapped value; a ball has a quaternion (x, y, z, w) of any length.

    Attributes:
        size: Number of coordinates.
        rates: Number of rates.
        balls: First coordinate and first rate of each ball.
    """

    def __init__(self, model: pin.Model, root: RootMotion) -> None:
        """Derive the coordinates from the numbers nq and nv of Pinocchio's joints."""
        # Index of each entry of q in (q of the root, coordinates, cosines, sines).
        order = list(range(model.joints[1].nq))
        circles: list[int] = []
        self.balls: list[tuple[int, int]] = []
        self.size = self.rates = 0
        joints = list(model.joints)[2:]
        first, count = len(order), sum(joint.nq == 2 for joint in joints)
        cosine = first + sum(joint.nq if joint.nq != 2 else 1 for joint in joints)
        for joint in joints:
            if joint.nq == 2:
                order += [cosine + len(circles), cosine + count + len(circles)]
                circles.append(self.size)
                self.size += 1
            else:
                if joint.nv == 3:
                    self.balls.append((self.size, self.rates))
                order += [first + self.size + k for k in range(joint.nq)]
                self.size += joint.nq
            self.rates += joint.nv
        self._root, self._has_circles = root, bool(circles)
        self._circles, self._order = np.array(circles, dtype=np.intp), np.array(order)

    def __call__(self, root: Array, joints: Array) -> Array:
        """Return q (..., nq) for root coordinates and the coordinates of all joints."""
        root_q, joints = self._root.q(root), self.normalised(joints)
        if not self._has_circles:
            return np.concatenate((root_q, joints), axis=-1)
        angles = joints[..., self._circles]
        parts = root_q, joints, np.cos(angles), np.sin(angles)
        return np.asarray(np.concatenate(parts, axis=-1)[..., self._order])

    def normalised(self, joints: Array) -> Array:
        """Return the coordinates of all joints, (..., size), with quaternions of length one."""
        if self.balls:
            joints = joints.copy()
            for first, _ in self.balls:
                normalise(joints[..., first : first + 4])
        return joints

    def derivative(self, joints: Array, v: Array) -> Sequence[Any]:
        """Return the time derivative of the coordinates at rates v; see RootMotion.rate."""
        derivative: list[Any] = []
        first_v = 0
        for x, rate in self.balls:
            derivative.extend(v[first_v:rate])
            i, j, k, w = joints[x : x + 4]
            a, b, c = v[rate : rate + 3]
            derivative += [
                0.5 * (w * a + j * c - k * b),
                0.5 * (w * b + k * a - i * c),
                0.5 * (w * c + i * b - j * a),
                -0.5 * (i * a + j * b + k * c),
            ]
            first_v = rate + 3
        return [*derivative, *v[first_v:]]
