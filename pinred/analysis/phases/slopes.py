"""Derivatives of a phase and of the effort of a gait by its Fourier coefficients, exact.

If a motion ġ = g ξ is varied, then g⁻¹δg = Ad_{g⁻¹} ∫ Ad_{g(t)} δξ(t) dt at its end, with
δξ = (∂ξ/∂x) δx + (∂ξ/∂ẋ) δẋ from machine code.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...common.arrays import Array, freeze
from ...common.errors import InputError
from ...integrators.gauss.tables import tables
from ...lie.group import Group
from ..connections.connection import Connection
from ..gaits.arcs import FourierArc
from ..gaits.gait import Gait
from .lift import STAGES, Pieces, in_space, lifted, nodes

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
    arc = gait.arcs[0]
    if not gait.is_smooth or not isinstance(arc, FourierArc):
        raise InputError("derivatives by coefficients need a gait that is one Fourier series")
    group, m, harmonics = connection.group, connection.m, len(arc.cos)
    count = _PER_HARMONIC * (harmonics + 1) if pieces is None else int(pieces)
    h = np.full(count, gait.period / count)
    s = ((np.arange(count)[:, None] + nodes()) / count).ravel()
    x, slope = arc.at(s)
    xdot = slope / arc.time
    xi, square = connection.horizontal(x, xdot)
    S = connection.horizontal_slopes(x, xdot)
    on_way = Pieces(
        h=h,
        a=in_space(group, xi).reshape(count, STAGES, 6),
        L=np.zeros((0, STAGES, 6, 6)),
    )
    found = lifted(group, on_way, np.zeros(group.dim))
    pose, r = found.path[-1], group.dim
    weights = np.tile(tables(STAGES).b, count) * h[0]
    values, rates = _basis(arc, s)
    carried = weights[:, None, None] * _adjoints(group, found.inner.reshape(-1, 7))

    def by_coefficients(rows: Array) -> Array:
        """Return the sums over the nodes of rows (N, k, 2m), as (k, 1 + 2 harmonics, m)."""
        by_x = np.tensordot(values.T, rows[..., :m], 1)
        by_rate = np.tensordot(rates.T, rows[..., m:], 1)
        return np.asarray(np.swapaxes(by_x + by_rate, 0, 1))

    twist = np.tensordot(group.Ad(group.inverse(pose)), by_coefficients(carried @ S[:, :r]), 1)
    none = np.full((1 + 2 * harmonics, m), np.nan)
    length = action = np.nan
    length_slope = action_slope = none
    if connection.has_metric:
        speed = np.sqrt(square)
        length, action = float(weights @ speed), float(weights @ square)
        with np.errstate(divide="ignore", invalid="ignore"):
            factors = np.where(speed > 0.0, 0.5 / speed, 0.0)
        length_slope = by_coefficients((weights * factors)[:, None, None] * S[:, r:])[0]
        action_slope = by_coefficients(weights[:, None, None] * S[:, r:])[0]
    return PhaseSlopes(pose.copy(), twist, length, length_slope, action, action_slope)


def _basis(arc: FourierArc, s: Array) -> tuple[Array, Array]:
    """Return 1, cos kφ, sin kφ and their rates, (N, 1 + 2 harmonics) each."""
    k = np.arange(1, len(arc.cos) + 1)
    turn = arc.end - arc.start
    angle = np.multiply.outer(arc.start + turn * s, k)
    c, s_, rate = np.cos(angle), np.sin(angle), turn / arc.time * k
    one = np.ones((len(s), 1))
    return np.hstack([one, c, s_]), np.hstack([0.0 * one, -rate * s_, rate * c])


def _adjoints(group: Group, inner: Array) -> Array:
    """Return Ad_g (N, r, r) of positions and quaternions (N, 7)."""
    linear = inner[:, list(group.axes[: group.linear])]
    q = inner[:, 3:] / np.linalg.norm(inner[:, 3:], axis=1, keepdims=True)
    if group.turns == 3:
        return group.Ad(np.concatenate([linear, q], axis=1))
    angle = 2.0 * np.arctan2(q[:, 2:3], q[:, 3:])
    return group.Ad(np.concatenate([linear, angle], axis=1) if group.turns else linear)
