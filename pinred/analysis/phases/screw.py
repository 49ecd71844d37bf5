"""The screw of a pose (Chasles): the steady drift or orbit that produces the pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, FrozenArrays
from ...lie.group import Group
from .lift import in_space

_STRAIGHT = 1e-12  # rotation below which a screw counts as a translation [rad]


@checks_arguments
@dataclass(frozen=True)
class Screw(FrozenArrays):
    """A rotation about an axis with a translation along it, in the initial frame of the base.

    Attributes:
        axis: Direction of the axis, (3,); without rotation, the direction of the translation.
        point: Point of the axis nearest to the origin, (3,) [m]; NaN without rotation.
        angle: Rotation [rad].
        slide: Translation along the axis [m].
    """

    axis: Array
    point: Array
    angle: float
    slide: float

    def __str__(self) -> str:
        axis = f"({', '.join(f'{value:.6g}' for value in self.axis)})"
        if self.angle:
            slide = f", slide {self.slide:.12g} m" if self.slide else ""
            return f"{self.angle:.12g} rad about {axis}{slide}"
        return f"none, but a slide of {self.slide:.12g} m along {axis}" if self.slide else "none"

    @property
    def radius(self) -> float:
        """Radius of the circle or helix of the base origin [m]; ∞ for a straight line."""
        return float(np.linalg.norm(self.point)) if np.isfinite(self.point).all() else np.inf


def screw_of(group: Group, pose: Array) -> Screw:
    """Compute the screw of a pose. A planar angle keeps its complete rotations."""
    log = group.log(pose)
    angles = log.copy()
    xi = in_space(group, log)
    v, w = xi[:3], xi[3:]
    angle = float(np.linalg.norm(w))
    if group.turns == 1:  # unlike its logarithm, the pose keeps complete rotations
        angles = np.array(pose[-1:])
    if angle < _STRAIGHT:
        slide = float(np.linalg.norm(v))
        axis = v / slide if slide > 0.0 else np.array([0.0, 0.0, 1.0])
        return Screw(axis, np.full(3, np.nan), 0.0, slide)
    axis = w / angle
    total = float(angles[0] * axis[2]) if group.turns == 1 else angle
    return Screw(axis, np.cross(w, v) / angle**2, total, float(v @ axis))
