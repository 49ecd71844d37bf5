"""Body velocities along a gait at Gauss nodes: sampled there, or interpolated between few samples.

On a gait that is one Fourier series everything is smooth and periodic, and the trigonometric
interpolant of N samples converges faster than any power of N; it is then evaluated at the Gauss
nodes of N/2 pieces.  On any other gait the nodes of the pieces of its arcs are sampled.
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
from .lift import STAGES, Pieces, in_space, in_space_by_momenta, nodes

_LEAST = 16  # samples of a smooth gait
_PER_HARMONIC = 16
MOST = 2**15  # samples


@dataclass(frozen=True)
class Sampled:
    """A gait sampled: its pieces, at how many shapes, and ∫√(ẋᵀMẋ) dt (NaN without a metric)."""

    pieces: Pieces
    samples: int
    length: float


class Samples(NamedTuple):
    """What is sampled at N shapes and rates.

    xi: (N, r).  inverse: (N, r²) rows of P_b⁻¹, or (N, 0) where it is not wanted.  speed: (N,)
    √(ẋᵀMẋ).  health: (N,) of P_b.
    """

    xi: Array
    inverse: Array
    speed: Array
    health: Array


def refined(connection: Connection, gait: Gait, *, momentum: bool) -> Iterator[Sampled]:
    """Yield the gait sampled again and again, each time twice as finely, up to MOST samples.

    momentum: whether P_b⁻¹ is wanted, too.
    """
    if connection.m != gait.m:
        raise InputError(
            f"the gait moves {gait.m} joints, but {connection} has {connection.m}: "
            f"{', '.join(connection.joints)}"
        )
    yield from (_smooth if gait.is_smooth else _by_pieces)(connection, gait, momentum)


def _smooth(connection: Connection, gait: Gait, momentum: bool) -> Iterator[Sampled]:
    (arc,) = gait.arcs
    harmonics = len(getattr(arc, "cos", ()))
    count = max(_LEAST, _PER_HARMONIC * harmonics)
    known: Samples | None = None
    while count <= MOST:
        # Every other one of twice as many samples is known.
        step = gait.period / count
        t = np.arange(count) * step if known is None else np.arange(1, count, 2) * step
        found = _at(connection, *gait.at(t), momentum)
        if known is not None:
            found = Samples(*(_woven(a, b) for a, b in zip(known, found, strict=True)))
        known = found
        connection.refuse_crossing(found.health)
        pieces = Pieces(
            h=np.full(count // 2, gait.period / (count // 2)),
            a=in_space(connection.group, _interpolated(found.xi)),
            L=_inverse_in_space(connection, _interpolated(found.inverse)) if momentum else _NOTHING,
        )
        yield Sampled(pieces, count, float(found.speed.mean() * gait.period))
        count *= 2


def _by_pieces(connection: Connection, gait: Gait, momentum: bool) -> Iterator[Sampled]:
    each = 1
    while STAGES * each * len(gait.arcs) <= MOST:
        starts = np.arange(each) / each
        s = (starts[:, None] + nodes() / each).ravel()
        parts = [arc.at(s) for arc in gait.arcs]
        x = np.concatenate([part[0] for part in parts])
        xdot = np.concatenate(
            [part[1] / arc.time for part, arc in zip(parts, gait.arcs, strict=True)]
        )
        found = _at(connection, x, xdot, momentum)
        connection.refuse_crossing(found.health)
        h = np.repeat([arc.time / each for arc in gait.arcs], each)
        shape = (len(h), STAGES)
        pieces = Pieces(
            h=h,
            a=in_space(connection.group, found.xi).reshape(*shape, 6),
            L=_inverse_in_space(connection, found.inverse.reshape(*shape, -1))
            if momentum
            else _NOTHING,
        )
        length = float((h[:, None] * tables(STAGES).b * found.speed.reshape(shape)).sum())
        yield Sampled(pieces, len(x), length)
        each *= 2


_NOTHING = np.zeros((0, STAGES, 6, 6))


def _at(connection: Connection, x: Array, xdot: Array, momentum: bool) -> Samples:
    """Return the samples at shapes and rates (N, m)."""
    found = connection.code.velocities(x, xdot)
    connection.refuse_singular(x, found.health)
    inverse: Array = np.zeros((len(x), 0))
    if momentum:
        inverse = np.asarray(np.linalg.inv(connection.locals_at(x)[2]).reshape(len(x), -1))
    speed = np.sqrt(np.maximum(found.square, 0.0))
    return Samples(found.xi, inverse, speed, found.health)


def _woven(known: Array, new: Array) -> Array:
    out = np.empty((2 * len(known), *known.shape[1:]))
    out[::2], out[1::2] = known, new
    return out


def _inverse_in_space(connection: Connection, rows: Array) -> Array:
    """Return P_b⁻¹ of rows (..., r²) as (..., 6, 6)."""
    r = connection.r
    return in_space_by_momenta(connection.group, rows.reshape(*rows.shape[:-1], r, r))


def _interpolated(values: Array) -> Array:
    """Return the trigonometric interpolant of (N, k) at the Gauss nodes of N/2 pieces."""
    count = len(values)
    shifts = _shifts(count)
    modes = np.fft.rfft(values, axis=0) / count  # wave numbers 0 … N/2
    half = count // 2
    # N/2 equidistant places cannot tell wave number k from k − N/2: the two are folded.  The
    # real part of twice the positive ones is all of them.
    modes[1:half] *= 2.0
    turned = shifts[..., None] * modes  # (8, N/2 + 1, k)
    folded = turned[:, :half].copy()
    folded[:, 0] += turned[:, half]
    return np.ascontiguousarray(np.moveaxis(np.fft.ifft(folded, axis=1).real * half, 0, 1))


@lru_cache(maxsize=32)
def _shifts(count: int) -> Array:
    """Return e^{ikδ}, (8, N/2 + 1), of the Gauss nodes δ in the first of N/2 pieces."""
    k = np.arange(count // 2 + 1)
    return np.exp(1j * np.multiply.outer(nodes() * (4.0 * np.pi / count), k))
