"""Body twists along a gait at Gauss nodes, evaluated or interpolated.

On a gait that is one Fourier series, everything is smooth and periodic. The trigonometric
interpolant of N samples then converges spectrally, and is evaluated at the Gauss nodes of N/2
segments. On any other gait, the connection is evaluated at the Gauss nodes of its arcs.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ...common.arrays import Array
from ...common.errors import InputError
from ...integrators.gauss.tables import tables
from ..connections.connection import Connection
from ..gaits.gait import Gait
from .lift import STAGES, PathSegments, in_space, in_space_by_momenta, nodes

_LEAST = 16  # smallest number of samples of a smooth gait
_PER_HARMONIC = 16  # initial samples per harmonic
MOST = 2**15  # largest number of samples


@dataclass(frozen=True)
class Sampled:
    """A sampled gait.

    Attributes:
        segments: Body twists at the Gauss nodes.
        samples: Number of shapes at which the connection was evaluated.
        length: ∫√(ẋᵀMẋ) dt; NaN if the connection has no metric.
    """

    segments: PathSegments
    samples: int
    length: float


class Samples(NamedTuple):
    """Values of a connection at N shapes and rates.

    Attributes:
        xi: Body twists −A ẋ, (N, r).
        inverse: P_b⁻¹ by rows, (N, r²), or (N, 0) if not requested.
        speed: √(ẋᵀMẋ), (N,).
        health: Condition measure of P_b, (N,), which changes sign across a singular shape.
    """

    xi: Array
    inverse: Array
    speed: Array
    health: Array


def refined(connection: Connection, gait: Gait, *, momentum: bool) -> Iterator[Sampled]:
    """Sample a gait repeatedly, each time twice as finely, up to MOST samples.

    Args:
        connection: Connection to evaluate.
        gait: Closed path in shape space.
        momentum: Whether P_b⁻¹ is needed as well.
    Yields:
        The sampled gait.
    Raises:
        InputError: Gait and connection have different numbers of joints.
    """
    if connection.m != gait.m:
        raise InputError(
            f"gait: expected {connection.m} joints for {connection}, got {gait.m}. The joints are "
            f"{', '.join(connection.joints)}"
        )
    yield from (_smooth if gait.is_smooth else _by_arcs)(connection, gait, momentum)


def _smooth(connection: Connection, gait: Gait, momentum: bool) -> Iterator[Sampled]:
    (arc,) = gait.arcs
    harmonics = len(getattr(arc, "cos", ()))
    count = max(_LEAST, _PER_HARMONIC * harmonics)
    coarse: Samples | None = None
    while count <= MOST:
        # Every other sample is known from the previous round.
        step = gait.period / count
        t = np.arange(count) * step if coarse is None else np.arange(1, count, 2) * step
        samples = _at(connection, *gait.at(t), momentum)
        if coarse is not None:
            samples = Samples(*(_interleave(a, b) for a, b in zip(coarse, samples, strict=True)))
        coarse = samples
        connection.refuse_crossing(samples.health)
        segments = PathSegments(
            h=np.full(count // 2, gait.period / (count // 2)),
            a=in_space(connection.group, _interpolated(samples.xi)),
            L=_inverse_in_space(connection, _interpolated(samples.inverse))
            if momentum
            else _NOTHING,
        )
        yield Sampled(segments, count, float(samples.speed.mean() * gait.period))
        count *= 2


def _by_arcs(connection: Connection, gait: Gait, momentum: bool) -> Iterator[Sampled]:
    per_arc = 1
    while STAGES * per_arc * len(gait.arcs) <= MOST:
        starts = np.arange(per_arc) / per_arc
        s = (starts[:, None] + nodes() / per_arc).ravel()
        arc_points = [arc.at(s) for arc in gait.arcs]
        x = np.concatenate([points[0] for points in arc_points])
        xdot = np.concatenate(
            [points[1] / arc.time for points, arc in zip(arc_points, gait.arcs, strict=True)]
        )
        samples = _at(connection, x, xdot, momentum)
        connection.refuse_crossing(samples.health)
        h = np.repeat([arc.time / per_arc for arc in gait.arcs], per_arc)
        shape = (len(h), STAGES)
        segments = PathSegments(
            h=h,
            a=in_space(connection.group, samples.xi).reshape(*shape, 6),
            L=_inverse_in_space(connection, samples.inverse.reshape(*shape, -1))
            if momentum
            else _NOTHING,
        )
        length = float((h[:, None] * tables(STAGES).b * samples.speed.reshape(shape)).sum())
        yield Sampled(segments, len(x), length)
        per_arc *= 2


_NOTHING = np.zeros((0, STAGES, 6, 6))


def _at(connection: Connection, x: Array, xdot: Array, momentum: bool) -> Samples:
    """Evaluate the connection at shapes and rates (N, m)."""
    velocities = connection.code.velocities(x, xdot)
    connection.refuse_singular(x, velocities.health)
    inverse: Array = np.zeros((len(x), 0))
    if momentum:
        inverse = np.asarray(np.linalg.inv(connection.locals_at(x)[2]).reshape(len(x), -1))
    speed = np.sqrt(np.maximum(velocities.square, 0.0))
    return Samples(velocities.xi, inverse, speed, velocities.health)


def _interleave(coarse: Array, midpoints: Array) -> Array:
    interleaved = np.empty((2 * len(coarse), *coarse.shape[1:]))
    interleaved[::2], interleaved[1::2] = coarse, midpoints
    return interleaved


def _inverse_in_space(connection: Connection, rows: Array) -> Array:
    """Embed rows (..., r²) of P_b⁻¹ as spatial maps, (..., 6, 6)."""
    r = connection.r
    return in_space_by_momenta(connection.group, rows.reshape(*rows.shape[:-1], r, r))


def _interpolated(values: Array) -> Array:
    """Interpolate values (N, k) trigonometrically at the Gauss nodes of N/2 segments."""
    count = len(values)
    shifts = _shifts(count)
    modes = np.fft.rfft(values, axis=0) / count  # wave numbers 0 … N/2
    half = count // 2
    # On N/2 equidistant nodes, wave numbers k and k − N/2 are equal, so fold them. Twice the real
    # part of the positive wave numbers gives all of them.
    modes[1:half] *= 2.0
    shifted = shifts[..., None] * modes  # (8, N/2 + 1, k)
    folded = shifted[:, :half].copy()
    folded[:, 0] += shifted[:, half]
    return np.ascontiguousarray(np.moveaxis(np.fft.ifft(folded, axis=1).real * half, 0, 1))


@lru_cache(maxsize=32)
def _shifts(count: int) -> Array:
    """Return e^{ikδ}, (8, N/2 + 1), for the Gauss nodes δ of the first of N/2 segments."""
    k = np.arange(count // 2 + 1)
    return np.exp(1j * np.multiply.outer(nodes() * (4.0 * np.pi / count), k))
