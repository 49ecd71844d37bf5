"""Exact derivatives of phase and effort of a gait with respect to its Fourier coefficients."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...common.arrays import Array, freeze
from ...common.errors import InputError
from ..connections.connection import Connection
from ..gaits.arcs import FourierArc
from ..gaits.gait import Gait
from .path_basis import PathBasis, by_coefficients, fourier_basis, path_lift

_PER_HARMONIC = 8  # segments


@dataclass(frozen=True)
class PhaseSlopes:
    """Phase and effort of a Fourier gait at zero momentum, with derivatives.

    The coefficients are (1 + 2 harmonics, m): mean, cosines, sines.

    Attributes:
        pose: Pose after one cycle, (size,).
        twist: g⁻¹∂g, (r, 1 + 2 harmonics, m).
        length: ∫√(ẋᵀMẋ) dt; NaN if the connection has no metric.
        length_slope: Derivative of the length, (1 + 2 harmonics, m).
        action: ∫ẋᵀMẋ dt; NaN if the connection has no metric.
        action_slope: Derivative of the action, (1 + 2 harmonics, m).
    """

    pose: Array
    twist: Array
    length: float
    length_slope: Array
    action: float
    action_slope: Array

    def __post_init__(self) -> None:
        freeze(self)


def phase_slopes(connection: Connection, gait: Gait, *, pieces: int | None = None) -> PhaseSlopes:
    """Compute the phase and the effort of a Fourier gait, and their derivatives.

    Args:
        connection: Connection that lifts the gait.
        gait: Gait that is one Fourier series.
        pieces: Number of segments of order 16; by default eight per harmonic.
    Returns:
        Values and derivatives.
    Raises:
        InputError: The gait is not one Fourier series.
    """
    connection.refuse_gravity()
    arc = gait.arcs[0]
    if not gait.is_smooth or not isinstance(arc, FourierArc):
        raise InputError("gait: expected one Fourier series; derivatives refer to its coefficients")
    harmonics, m = len(arc.cos), connection.m
    count = _PER_HARMONIC * (harmonics + 1) if pieces is None else int(pieces)
    basis = fourier_basis(harmonics, count, start=arc.start, turn=arc.end - arc.start)
    lift = path_lift(connection, basis, np.vstack([arc.mean[None], arc.cos, arc.sin]))
    length = action = np.nan
    length_slope = action_slope = np.full((1 + 2 * harmonics, m), np.nan)
    if connection.has_metric:
        speed, weights = np.sqrt(lift.square), basis.weights
        length, action = float(weights @ speed), float(weights @ lift.square) / arc.time
        with np.errstate(divide="ignore", invalid="ignore"):
            factors = np.where(speed > 0.0, 0.5 / speed, 0.0)
        length_slope = _sum_over_nodes(basis, (weights * factors)[:, None] * lift.square_slopes)
        action_slope = _sum_over_nodes(basis, weights[:, None] * lift.square_slopes) / arc.time
    return PhaseSlopes(lift.pose, lift.twist, length, length_slope, action, action_slope)


def _sum_over_nodes(basis: PathBasis, derivatives: Array) -> Array:
    """Sum derivatives (N, 2m) with respect to (x, x′) over the nodes, to (K, m)."""
    by_x, by_slope = np.split(derivatives[:, None], 2, axis=2)
    return np.asarray(by_coefficients(basis, by_x, by_slope)[0])
