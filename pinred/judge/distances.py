"""Motions of the full system, and how far two of them are apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..common.arrays import Array


@dataclass(frozen=True)
class FullMotion:
    """A motion in Pinocchio's coordinates.  x: (T, M) unwrapped, of all joints.  q: (T, nq)."""

    x: Array
    q: Array


@dataclass(frozen=True)
class Size:
    """The units in which errors of a motion are measured.

    joints: (M,) the largest |x| of each joint, at least 1 rad, or the radius of gyration of what
    slides [rad | m].  position: the distance travelled by the base, at least the radius of
    gyration and what round-off leaves of its distance from the origin [m].  away: that distance.
    """

    joints: Array
    position: float
    away: float


@dataclass(frozen=True)
class Distance:
    """Distances of two motions.

    joints: (T, M) |Δx| of each joint [rad | m].  rotation [rad] and position [m]: (T,) norms of
    the parts of log(g⁻¹ĝ) of the base.
    """

    joints: Array
    rotation: Array
    position: Array

    @property
    def shape(self) -> Array:
        """Largest |Δx| over time, (T,) [rad | m]."""
        return np.asarray(self.joints.max(axis=1, initial=0.0))

    def relative(self, size: Size) -> Array:
        """Return the largest of all over time, (T,), in units of the motion's size; NaN stays."""
        shape = (self.joints / size.joints).max(axis=1, initial=0.0)
        return np.asarray(np.max([shape, self.rotation, self.position / size.position], axis=0))

    def worst(self, size: Size) -> float:
        """Return the largest of all, in units of the motion's size; NaN if there is one."""
        return float(self.relative(size).max())
