"""The screw of a pose: the steady drift or orbit that makes it (Chasles)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...common.arrays import Array, freeze
from ...lie.group import Group
from .lift import in_space

_STRAIGHT = 1e-12  # rad; a turn below it is none


@dataclass(frozen=True)
class Screw:
    """A turn about an axis with a slide along it; in the frame in which the cycle began.

    axis: (3,) direction, of the slide where nothing turns.  point: (3,) of the axis nearest to the
    origin [m]; NaN where nothing turns.  angle: of the turn [rad].  slide: along the axis [m].
    """

    axis: Array
    point: Array
    angle: float
    slide: float

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def radius(self) -> float:
        """Radius of the circle or helix of the body's origin [m]; ∞ of a straight line."""
        return float(np.linalg.norm(self.point)) if np.isfinite(self.point).all() else np.inf


def screw_of(group: Group, pose: Array) -> Screw:
    """Return the screw of a pose; a planar angle counts with its whole turns."""
    log = group.log(pose)
    turned = log.copy()
    xi = in_space(group, log)
    v, w = xi[:3], xi[3:]
    angle = float(np.linalg.norm(w))
    if group.turns == 1:  # whole turns are in the pose, not in its logarithm
        turned = np.array(pose[-1:])
    if angle < _STRAIGHT:
        slide = float(np.linalg.norm(v))
        axis = v / slide if slide > 0.0 else np.array([0.0, 0.0, 1.0])
        return Screw(axis, np.full(3, np.nan), 0.0, slide)
    axis = w / angle
    total = float(turned[0] * axis[2]) if group.turns == 1 else angle
    return Screw(axis, np.cross(w, v) / angle**2, total, float(v @ axis))
