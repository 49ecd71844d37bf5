"""The root joint of the full simulation, read from Pinocchio's motion subspace alone."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin, sqrt

import numpy as np
import pinocchio as pin

from ..common.arrays import Array


@dataclass(frozen=True)
class RootMotion:
    """The motion of the root joint of a model.

    axes: (6, r) of its motion in its fixed frame, slides first.  linear, turns: how many
    slides, how many rotations.  plane: which two slides a single hinge turns into each other,
    if any.  circle: whether Pinocchio keeps its angle as cosine and sine.
    """

    axes: Array
    linear: int
    turns: int
    plane: tuple[int, int] | None
    circle: bool

    @property
    def size(self) -> int:
        """Number of coordinates: positions; angle or quaternion."""
        return self.linear + (4 if self.turns == 3 else self.turns)

    @property
    def is_pivoted(self) -> bool:
        """Whether it turns about what it cannot slide across: momentum is about that."""
        slides_across = self.plane is not None or (self.turns == 3 and self.linear == 3)
        return self.turns > 0 and not slides_across

    def rate(self, root: Array, v: Array) -> Array:
        """Return the rate of its coordinates (size,) at a body twist (r,)."""
        if self.turns < 3:
            if self.plane is None:
                return v
            out, (i, j) = v.copy(), self.plane
            c, s = cos(root[-1]), sin(root[-1])
            out[i], out[j] = c * v[i] - s * v[j], s * v[i] + c * v[j]
            return out
        # Written out: with arrays of three it takes four times as long.
        i, j, k, w = root[-4:].tolist()
        *slide, p, q, s = v.tolist()
        turn = [
            0.5 * (w * p + j * s - k * q),
            0.5 * (w * q + k * p - i * s),
            0.5 * (w * s + i * q - j * p),
            -0.5 * (i * p + j * q + k * s),
        ]
        if not slide:
            return np.array(turn)
        a, b, c = slide  # turned by 1 + 2 (w ω̂ + ω̂²) / |q|²
        two = 2.0 / (i * i + j * j + k * k + w * w)
        l, m, n = two * (j * c - k * b), two * (k * a - i * c), two * (i * b - j * a)
        return np.array(
            [
                a + w * l + j * n - k * m,
                b + w * m + k * l - i * n,
                c + w * n + i * m - j * l,
                *turn,
            ]
        )

    def q(self, root: Array) -> Array:
        """Return Pinocchio's configuration of the joint."""
        if self.circle:
            return np.array([*root[:-1], cos(root[-1]), sin(root[-1])])
        q = root.copy()
        if self.turns == 3:
            quaternion = q[-4:]
            quaternion /= sqrt(quaternion @ quaternion)
        return q


def root_motion(model: pin.Model) -> RootMotion:
    """Return how the root joint of a model moves."""
    joint, alone = model.joints[1], pin.Model()
    alone.addJoint(0, joint, pin.SE3.Identity(), "alone")
    data = alone.createData()
    pin.computeJointJacobians(alone, data, pin.neutral(alone))
    axes = np.array(data.joints[1].S).reshape(6, joint.nv)
    linear = int((~axes[3:].any(axis=0)).sum())
    turns = joint.nv - linear
    plane = _plane(axes, linear) if turns == 1 else None
    return RootMotion(axes, linear, turns, plane, circle=turns == 1 and joint.nq > joint.nv)


def _plane(axes: Array, linear: int) -> tuple[int, int] | None:
    """Return which two slides of a root joint its one hinge turns into each other, if any."""
    turned = np.cross(axes[3:, -1], axes[:3, :linear], axis=0)
    onto = axes[:3, :linear].T @ turned  # (i, j): how much of slide j goes to slide i
    found = np.argwhere(onto > 0.5)
    return (int(found[0, 1]), int(found[0, 0])) if found.size else None
