"""Polygons in polar form: corners on fixed rays from a free centre, so that the loop is simple."""

from __future__ import annotations

import numpy as np

from ...analysis.gaits.gait import Gait
from ...analysis.phases.path_basis import polygon_basis
from ...common.arrays import Array
from .transcription import Path

_EACH = 1  # pieces of order 16 of an edge


def polygon_path(corners: int, *, clockwise: bool) -> Path:
    """Return the polygons whose unknowns are the centre (2,) and the distances r_k ≥ 0 of corners.

    Corner k is centre + r_k (cos φ_k, sin φ_k), φ_k = ±2πk/corners.
    """
    angles = 2.0 * np.pi * np.arange(corners) / corners * (-1.0 if clockwise else 1.0)
    matrix = np.zeros((corners, 2, 2 + corners))
    matrix[:, 0, 0] = matrix[:, 1, 1] = 1.0
    for k, angle in enumerate(angles):
        matrix[k, :, 2 + k] = np.cos(angle), np.sin(angle)
    at_corners = np.eye(corners), np.zeros((corners, corners)), np.zeros((corners, corners))
    return Path(
        polygon_basis(corners, _EACH), at_corners, matrix.reshape(2 * corners, -1),
        np.zeros((corners, 2)),
    )  # fmt: skip


def polygon_gait(path: Path, y: Array, period: float) -> Gait:
    """Return the polygon with unknowns y as a gait, at one speed."""
    return Gait.waypoints(path.coefficients(y), period=period)
