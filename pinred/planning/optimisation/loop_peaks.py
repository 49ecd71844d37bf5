"""Peaks of a Fourier loop as constraints: the true extremes of shapes, speeds and torques.

The period is divided into cells.  A limited quantity q of a joint is scaled so that its limit is
|q| ≤ 1.  The maximum of |q| over a cell is one constraint.  By the envelope theorem its derivative
is the derivative of q at the maximum, also when the maximum moves across an edge of the cell.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...analysis.connections.connection import Connection
from ...analysis.phases.path_basis import fourier_rows
from ...common.arrays import Array, FrozenArrays
from .limits import Limits
from .objective import torque_order, torque_slopes, torques

_PER_HARMONIC = 8  # cells per harmonic and period: a cell holds at most one crest of the loop
_TORQUE = 2  # kind of quantity; kinds 0 and 1 are shapes and speeds
_SAMPLES = 8  # samples per cell
_REFINEMENTS = 4  # number of parabolas that refine a maximum
_NARROWER = 0.1  # width of each parabola, relative to the previous one


@dataclass(frozen=True, eq=False)
class Cells(FrozenArrays):
    """Cells of the period in which quantities are limited.

    Attributes:
        count: Number of equal cells of the period.
        kind: Limited quantity: 0 shape, 1 speed, 2 torque, (N,).
        joint: Index of the joint, (N,).
        start: Start s of the cell, (N,).
    """

    count: int
    kind: Array
    joint: Array
    start: Array

    def select(self, chosen: NDArray[np.bool_]) -> Cells:
        """Return the cells of a mask, (N,)."""
        return Cells(self.count, self.kind[chosen], self.joint[chosen], self.start[chosen])


def cells_of(limits: Limits, harmonics: int) -> Cells:
    """Return all cells of all limited quantities.

    Args:
        limits: The limits.
        harmonics: Number of harmonics of the loop.
    Returns:
        The cells.
    """
    count = _PER_HARMONIC * (harmonics + 1)
    limited = np.isfinite(np.stack([limits.reach, limits.speed, limits.torque]))
    kind, joint = np.nonzero(limited)
    starts = np.arange(count) / count
    return Cells(count, np.repeat(kind, count), np.repeat(joint, count), np.tile(starts, len(kind)))


class Peaks(NamedTuple):
    """Maxima of |q| over cells, with derivatives.

    Attributes:
        values: Maxima, (N,).
        by_c: Derivatives with respect to the path coefficients, (N, K, m).
        by_log_period: Derivatives with respect to the logarithm of the period, (N,).
    """

    values: Array
    by_c: Array
    by_log_period: Array


def loop_peaks(
    connection: Connection, limits: Limits, c: Array, period: float, cells: Cells
) -> Peaks:
    """Compute the peaks of a Fourier loop, scaled by the limits.

    Args:
        connection: The connection.
        limits: The limits.
        c: Coefficients of the loop: mean, cosines and sines, (K, m).
        period: Period T [s].
        cells: The cells.
    Returns:
        The peaks in these cells.
    """
    values, by_c = np.zeros(len(cells.joint)), np.zeros((len(cells.joint), *c.shape))
    orders = np.array([0, 1, torque_order(connection)])
    for kind in np.unique(cells.kind):
        chosen = cells.kind == kind
        compute = _torques if kind == _TORQUE else _coordinates
        values[chosen], by_c[chosen] = compute(
            connection, limits, c, period, cells.select(chosen), int(kind)
        )
    return Peaks(values, by_c, -orders[cells.kind] * values)


def locate_peaks(values: Callable[[Array], Array], cells: Cells) -> Array:
    """Locate the maxima of |q| in cells.

    Args:
        values: Functions q, one per cell: s (N, p) → (N, p).
        cells: The cells.
    Returns:
        Positions, (N,).
    """
    width = 1.0 / cells.count
    offsets = np.linspace(0.0, width, _SAMPLES + 1)
    low, high = cells.start, cells.start + width
    position = low + offsets[np.abs(values(low[:, None] + offsets)).argmax(axis=1)]
    width /= _SAMPLES
    for _ in range(_REFINEMENTS):
        centre = np.clip(position, low + width, high - width)
        points = centre[:, None] + width * np.array([-1.0, 0.0, 1.0])
        left, middle, right = np.abs(values(points)).T
        bend, slope = left - 2.0 * middle + right, 0.5 * (right - left)
        vertex = np.divide(-slope, bend, out=np.sign(slope), where=bend < 0.0)
        position = np.clip(centre + width * np.clip(vertex, -1.0, 1.0), low, high)
        width *= _NARROWER
    return np.asarray(position)


def _coordinates(
    _: Connection, limits: Limits, c: Array, period: float, cells: Cells, order: int
) -> tuple[Array, Array]:
    """Return the peaks of shapes (order 0) or speeds (order 1), and their derivatives by c."""
    harmonics, joint = (len(c) - 1) // 2, cells.joint
    zero = (limits.middle if order == 0 else np.zeros(c.shape[1]))[joint]
    scale = (limits.reach if order == 0 else limits.speed * period)[joint]

    def scaled(s: Array) -> Array:
        rows = fourier_rows(harmonics, s.ravel())[order].reshape(*s.shape, -1)
        return np.asarray(
            ((rows * c.T[joint][:, None]).sum(axis=2) - zero[:, None]) / scale[:, None]
        )

    at = locate_peaks(scaled, cells)
    values = scaled(at[:, None])[:, 0]
    rows = fourier_rows(harmonics, at)[order]
    by_c = np.zeros((len(at), *c.shape))
    by_c[np.arange(len(at)), :, joint] = (np.sign(values) / scale)[:, None] * rows
    return np.abs(values), by_c


def _torques(
    connection: Connection, limits: Limits, c: Array, period: float, cells: Cells, _: int
) -> tuple[Array, Array]:
    """Return the peaks of torques, and their derivatives by c."""
    harmonics, m, joint = (len(c) - 1) // 2, c.shape[1], cells.joint
    scale = limits.torque[joint] * period ** torque_order(connection)
    each = np.arange(len(joint))

    def scaled(s: Array) -> Array:
        states = (rows @ c for rows in fourier_rows(harmonics, s.ravel()))
        tau = torques(connection, *states).reshape(*s.shape, m)
        return np.asarray(tau[each, :, joint] / scale[:, None])

    at = locate_peaks(scaled, cells)
    values = scaled(at[:, None])[:, 0]
    rows = fourier_rows(harmonics, at)
    covector = np.zeros((len(at), m))
    covector[each, joint] = np.sign(values) / scale
    x, slope, bend = (row @ c for row in rows)
    slopes = torque_slopes(connection, x, slope, bend, covector)
    by_c = sum(row[:, :, None] * slopes[:, None, k * m : (k + 1) * m] for k, row in enumerate(rows))
    return np.abs(values), np.asarray(by_c)
