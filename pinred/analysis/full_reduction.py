"""The reduction of a system, at one shape by Pinocchio and over many shapes by compiled code."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from ..common.arrays import vectors
from ..reduction.at_a_shape import PointwiseReduction

if TYPE_CHECKING:
    from .connections.shape_field import ShapeField


class Reduction(PointwiseReduction):
    """The reduction of one system, at any shape or over many shapes.

    Every method computes anew from its arguments.  It raises ShapeError if a shape x (m,)
    [rad | m] has the wrong length or is not finite, and SingularInertiaError if the mass matrix is
    numerically singular there.  To get several quantities at one shape, call `at`, which computes
    them together.  An instance owns Pinocchio work space, so use one per thread.
    """

    def grid(self, shapes: ArrayLike) -> ShapeField:
        """Return the same quantities at many shapes, as a field over the leading axes.

            a = np.linspace(-1.0, 1.0, 41)
            field = red.grid(np.stack(np.meshgrid(a, a, indexing="ij"), axis=-1))
            field.curvature[:, :, 2, 0, 1]  # (41, 41): the rotation part of B_01 on SE(2)

        Each quantity is computed at first use, by compiled code instead of Pinocchio.

        Args:
            shapes: Shapes, (..., m) [rad | m].
        Returns:
            The field.
        Raises:
            ShapeError: shapes has the wrong length or an entry that is not finite.
        """
        from .connections.shape_field import ShapeField

        label, names = f"shapes of {self.system.name!r}", self.system.shape_names
        x = vectors(shapes, self.system.m, label, names).copy()
        flat = x.reshape(math.prod(x.shape[:-1]), self.system.m)
        moves = tuple(frame.moves(flat) for frame in self.frames)
        return ShapeField(self.system, x, self._potential, moves)
