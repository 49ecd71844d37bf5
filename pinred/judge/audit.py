"""What Pinocchio's own functions say of a trajectory: drifts, and fields that do not agree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..common.arrays import Array


@dataclass(frozen=True)
class Audit:
    """The verdict of Pinocchio's own functions on the states of a trajectory, all relative.

    energies: (T,) change over the largest kinetic energy T about the centre of mass; where more,
    over what a turn by 1 rad, or a slide by the size of the robot, takes against weights and
    springs: states are right to parts of that, however small a motion is.
    momenta: (T, r) change of each conserved component, angular about the centre of mass if
    the group moves it freely, over √(2mT), for angular ones times the radius of gyration; about a
    pivot, over what its weight gives it from 1 rad away, where that is more.
    fields: largest difference of pose, twist, momenta and energy from those that q and v have.
    """

    energies: Array
    momenta: Array
    fields: float

    @property
    def energy(self) -> float:
        """The largest change of energy."""
        return float(np.abs(self.energies).max())

    @property
    def momentum(self) -> float:
        """The largest change of momentum."""
        return float(np.abs(self.momenta).max())


def difference(a: Array, b: Array, least: float) -> float:
    """Return the largest difference over the largest entry of b, or over `least`; NaN stays."""
    return _ratio(float(np.abs(a - b).max()), max(least, float(np.abs(b).max())))


def _ratio(change: float, scale: float) -> float:
    return change / scale if scale > 0.0 else change
