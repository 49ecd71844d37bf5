"""Motions of the full system, and distances between two of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..common.arrays import Array


@dataclass(frozen=True)
class FullMotion:
    """A motion in Pinocchio's coordinates.

    Attributes:
        x: Coordinates of all joints over time: unwrapped values, and quaternions of balls.
        q: Pinocchio's configurations, (T, nq).
    """

    x: Array
    q: Array


@dataclass(frozen=True)
class Size:
    """Units in which errors of a motion are measured.

    Attributes:
        joints: Largest |x| of each joint, (M,); at least 1 rad, or the radius of gyration for
            slides; 1 rad for each axis of a ball [rad | m].
        position: Distance travelled by the base; at least the radius of gyration, and at least a
            small fraction of `away`, because round-off grows with `away` [m].
        away: Largest distance of the base from the origin [m].
    """

    joints: Array
    position: float
    away: float


@dataclass(frozen=True)
class Distance:
    """Distances between two motions over time.

    Attributes:
        joints: |Δx| of each joint; for a ball, the components of the rotation vector of its
            attitude relative to the other, (T, M) [rad | m].
        rotation: Norm of the rotational part of log(g⁻¹ĝ) of the base, (T,) [rad].
        position: Norm of the translational part of log(g⁻¹ĝ), (T,) [m].
    """

    joints: Array
    rotation: Array
    position: Array

    @property
    def shape(self) -> Array:
        """Largest |Δx| of any joint over time, (T,) [rad | m]."""
        return np.asarray(self.joints.max(axis=1, initial=0.0))

    def relative(self, size: Size) -> Array:
        """Return the largest of all distances at each time, (T,), in units of `size`.

        The result is NaN at times at which any distance is NaN.
        """
        shape = (self.joints / size.joints).max(axis=1, initial=0.0)
        return np.asarray(np.max([shape, self.rotation, self.position / size.position], axis=0))

    def worst(self, size: Size) -> float:
        """Return the largest distance at any time in units of `size`; NaN if one of them is NaN."""
        return float(self.relative(size).max())
