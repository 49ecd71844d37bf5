"""Points: values of the unknowns of relative equilibria, and displacements between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array
from ...lie.rotations import rotation
from ...system.coordinates import ShapeSpace
from .loop_surface import LoopSurface

Which: TypeAlias = slice | list[int] | NDArray[Any]


@dataclass(frozen=True)
class Points:
    """Values of the unknowns at N points.

    Attributes:
        x: Coordinates of the active joints, (N, k).
        n: Directions in the body, (N, 3), or (N, 0) if none is unknown.
        space: Manifold of the active joints; None if they are hinges and slides.
        surface: Closed shapes of loops; None without loops.
    """

    x: Array
    n: Array
    space: ShapeSpace | None = None
    surface: LoopSurface | None = None

    def __len__(self) -> int:
        return len(self.x)

    def __getitem__(self, key: Which) -> Points:
        return self.at(self.x[key], self.n[key])

    @property
    def dimension(self) -> int:
        """Dimension of the manifold of the active joints."""
        return self.x.shape[1] if self.space is None else self.space.m

    def at(self, x: Array, n: Array) -> Points:
        """Return points of the same manifold."""
        return replace(self, x=x, n=n)

    def shape_difference(self, other: Points) -> Array:
        """Return the displacements, (N, ma), from these shapes to those of other points."""
        if self.space is None:
            return np.asarray(other.x - self.x)
        return self.space.difference(self.x, other.x)

    def shape_displaced(self, displacement: Array) -> Array:
        """Return the coordinates, (N, k), after displacements (N, ma)."""
        if self.space is None:
            return np.asarray(self.x + displacement)
        return self.space.integrate(self.x, displacement)

    @property
    def from_rest(self) -> Array:
        """Values of hinges and slides, and rotation vectors of balls, (N, ma)."""
        if self.space is None:
            return self.x
        return self.space.difference(self.space.neutral, self.x)

    def difference(self, other: Points) -> Array:
        """Return the differences of other points from these, (N, ma + 3) or (N, ma)."""
        return np.concatenate([self.shape_difference(other), other.n - self.n], axis=1)

    def moved(self, step: Array) -> Points:
        """Return the points after a step.

        Args:
            step: Displacements along the frame of the shape, or along the closed shapes of loops,
                and on the tangent plane of the sphere, (N, unknowns).
        Returns:
            The new points, with unit directions.
        """
        ma = self.dimension if self.surface is None else self.dimension - self.surface.rank
        if self.surface is None:
            x = self.shape_displaced(step[:, :ma])
        else:
            x = self.surface.moved(self.x, step[:, :ma])
        if not self.n.shape[1]:
            return self.at(x, self.n)
        n = self.n + (tangents(self.n) @ step[:, ma:, None])[..., 0]
        return self.at(x, n / np.linalg.norm(n, axis=1, keepdims=True))


def tangents(n: Array) -> Array:
    """Return orthonormal bases (N, 3, 2) of the tangent planes at unit vectors (N, 3)."""
    least = np.eye(3)[np.argmin(np.abs(n), axis=1)]
    a = np.cross(n, least)
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    return np.stack([a, np.cross(n, a)], axis=-1)


def joined(parts: Sequence[Points]) -> Points:
    """Concatenate points.

    Args:
        parts: At least one set of points.
    Returns:
        All points, in order.
    """
    x, n = (np.concatenate([getattr(p, name) for p in parts]) for name in ("x", "n"))
    return parts[0].at(x, n)


def embedded(points: Points, angles: NDArray[np.bool_]) -> Array:
    """Return coordinates that are equal for equal points: angles as cosine and sine.

    Attitudes of balls are rotation matrices.

    Args:
        points: Points, (N,).
        angles: Which coordinates of active joints are periodic angles, (k,).
    Returns:
        (N, l).
    """
    x, lines, rotations = points.x[:, angles], ~angles, []
    if points.space is not None:
        lines[points.space.ball_x] = False
        rotations = [rotation(points.x[:, joint.x]) for joint in points.space.balls]
    flat = [matrix.reshape(len(points), 9) for matrix in rotations]
    return np.concatenate([np.cos(x), np.sin(x), points.x[:, lines], points.n, *flat], axis=1)
