"""Polygons without self-intersection: corners on fixed rays from a variable centre."""

from __future__ import annotations

import numpy as np

from ...analysis.gaits.gait import Gait
from ...analysis.phases.path_basis import polygon_basis
from ...common.arrays import Array
from .transcription import Path

_PIECES = 1  # quadrature pieces of order 16 for each edge


def polygon_path(corners: int, *, clockwise: bool) -> Path:
    """Return the polygons with corners on fixed rays from a variable centre.

    Corner k is centre + r_k (cos φ_k, sin φ_k) with φ_k = ±2πk/corners.  The unknowns are the
    centre, (2,), and the distances r_k ≥ 0.

    Args:
        corners: Number of corners.
        clockwise: Whether the corners are in clockwise order.
    Returns:
        The paths.
    """
    angles = 2.0 * np.pi * np.arange(corners) / corners * (-1.0 if clockwise else 1.0)
    matrix = np.zeros((corners, 2, 2 + corners))
    matrix[:, 0, 0] = matrix[:, 1, 1] = 1.0
    for k, angle in enumerate(angles):
        matrix[k, :, 2 + k] = np.cos(angle), np.sin(angle)
    at_corners = np.eye(corners), np.zeros((corners, corners)), np.zeros((corners, corners))
    return Path(
        polygon_basis(corners, _PIECES), at_corners, matrix.reshape(2 * corners, -1),
        np.zeros((corners, 2)),
    )  # fmt: skip


def polygon_gait(path: Path, y: Array, period: float) -> Gait:
    """Convert a polygon to a gait of constant speed.

    Args:
        path: The polygons.
        y: Unknowns.
        period: Period [s].
    Returns:
        The gait.
    """
    return Gait.waypoints(path.coefficients(y), period=period)
