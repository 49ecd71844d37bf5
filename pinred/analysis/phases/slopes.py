"""Derivatives of a phase and of the effort of a gait by its Fourier coefficients, exact."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...common.arrays import Array, freeze
from ...common.errors import InputError
from ..connections.connection import Connection
from ..gaits.arcs import FourierArc
from ..gaits.gait import Gait
from .path_basis import PathBasis, by_coefficients, fourier_basis, path_lift

_PER_HARMONIC = 8  # pieces


@dataclass(frozen=True)
class PhaseSlopes:
    """Values and derivatives by the coefficients of a Fourier gait, at zero momentum.

    Coefficients are (1 + 2 harmonics, m): the mean, then the cosines, then the sines.  pose:
    (size,) of one cycle.  twist: (r, 1 + 2 harmonics, m), g⁻¹ ∂g.  length: ∫√(ẋᵀMẋ) dt, and action:
    ∫ẋᵀMẋ dt, with their slopes (1 + 2 harmonics, m); NaN where the connection has no metric.
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
    """Return the phase of a Fourier gait, its effort, and the derivatives of both.

    pieces: of order 16 in which the cycle is integrated; eight a harmonic if not given.
    Raises InputError for a gait that is not one Fourier series, and as `phase`.
    """
    connection.refuse_gravity()
    arc = gait.arcs[0]
    if not gait.is_smooth or not isinstance(arc, FourierArc):
        raise InputError("derivatives by coefficients need a gait that is one Fourier series")
    harmonics, m = len(arc.cos), connection.m
    count = _PER_HARMONIC * (harmonics + 1) if pieces is None else int(pieces)
    basis = fourier_basis(harmonics, count, start=arc.start, turn=arc.end - arc.start)
    found = path_lift(connection, basis, np.vstack([arc.mean[None], arc.cos, arc.sin]))
    length = action = np.nan
    length_slope = action_slope = np.full((1 + 2 * harmonics, m), np.nan)
    if connection.has_metric:
        speed, weights = np.sqrt(found.square), basis.weights
        length, action = float(weights @ speed), float(weights @ found.square) / arc.time
        with np.errstate(divide="ignore", invalid="ignore"):
            factors = np.where(speed > 0.0, 0.5 / speed, 0.0)
        length_slope = _summed(basis, (weights * factors)[:, None] * found.square_slopes)
        action_slope = _summed(basis, weights[:, None] * found.square_slopes) / arc.time
    return PhaseSlopes(found.pose, found.twist, length, length_slope, action, action_slope)


def _summed(basis: PathBasis, rows: Array) -> Array:
    """Return the sum over the nodes of rows (N, 2m) by (x, x′), as (K, m)."""
    by_x, by_slope = np.split(rows[:, None], 2, axis=2)
    return np.asarray(by_coefficients(basis, by_x, by_slope)[0])
