"""Paths that are linear in coefficients, and the derivatives of their lift by these.

x(s) = Σ_k Φ_k(s) c_k for s in [0, 1].  If a motion ġ = g ξ is varied, then
g⁻¹δg = Ad_{g⁻¹} ∫ Ad_{g(s)} δξ ds at its end; δξ = (∂ξ/∂x) δx + (∂ξ/∂x′) δx′ by machine code.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...common.arrays import Array, freeze
from ...integrators.gauss.tables import tables
from ...lie.group import Group
from ..connections.connection import Connection
from .drift import Drift
from .lift import STAGES, Pieces, in_space, in_space_by_momenta, lifted, nodes


@dataclass(frozen=True, eq=False)
class PathBasis:
    """The functions Φ at the N = 8 P Gauss nodes of P pieces.

    h: (P,) lengths of the pieces, of s.  values, slopes, bends: (N, K), Φ, Φ′ and Φ″.
    """

    h: Array
    values: Array
    slopes: Array
    bends: Array

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def weights(self) -> Array:
        """Weights of the nodes in an integral over s, (N,)."""
        return np.asarray((self.h[:, None] * tables(STAGES).b).ravel())


def fourier_basis(
    harmonics: int, pieces: int, *, start: float = 0.0, turn: float = 2.0 * np.pi
) -> PathBasis:
    """Return 1, cos kφ, sin kφ, k = 1 … harmonics, with φ = start + turn s: K = 1 + 2 harmonics."""
    values, slopes, bends = fourier_rows(harmonics, piece_nodes(pieces), start=start, turn=turn)
    return PathBasis(np.full(pieces, 1.0 / pieces), values, slopes, bends)


def cycloid_basis(harmonics: int, pieces: int, cycles: int) -> PathBasis:
    """Return the same functions of s in [0, 1], passed through `cycles` times from rest to rest.

    φ = cycles (a − sin a), a = 2πs.
    """
    s = piece_nodes(pieces)
    angle, rate, bend = cycloid(s, cycles)
    values, slopes, bends = fourier_rows(harmonics, angle, turn=1.0)
    return PathBasis(
        np.full(pieces, 1.0 / pieces), values, rate[:, None] * slopes,
        rate[:, None] ** 2 * bends + bend[:, None] * slopes,
    )  # fmt: skip


def cycloid(s: Array, cycles: int) -> tuple[Array, Array, Array]:
    """Return φ = cycles (a − sin a), a = 2πs, and its first and second derivatives by s, (N,)."""
    a = 2.0 * np.pi * s
    return (
        cycles * (a - np.sin(a)),
        2.0 * np.pi * cycles * (1.0 - np.cos(a)),
        (2.0 * np.pi) ** 2 * cycles * np.sin(a),
    )


def fourier_rows(
    harmonics: int, s: Array, *, start: float = 0.0, turn: float = 2.0 * np.pi
) -> tuple[Array, Array, Array]:
    """Return 1, cos kφ, sin kφ at s (N,), and their first and second derivatives, (N, K) each."""
    k = np.arange(1, harmonics + 1)
    angle, rate = np.multiply.outer(start + turn * s, k), turn * k
    c, s_, none = np.cos(angle), np.sin(angle), np.zeros((len(s), 1))
    return (
        np.hstack([none + 1.0, c, s_]),
        np.hstack([none, -rate * s_, rate * c]),
        np.hstack([none, -(rate**2) * c, -(rate**2) * s_]),
    )


def polygon_basis(corners: int, each: int) -> PathBasis:
    """Return the straight edges from corner to corner and back to the first, K = corners.

    each: pieces of an edge.  Every edge takes the same part of s.
    """
    along = piece_nodes(each)  # of one edge
    count = len(along)
    values, slopes = np.zeros((2, corners * count, corners))
    for k in range(corners):
        rows = slice(k * count, (k + 1) * count)
        values[rows, k], values[rows, (k + 1) % corners] = 1.0 - along, along
        slopes[rows, k], slopes[rows, (k + 1) % corners] = -corners, corners
    h = np.full(corners * each, 1.0 / (corners * each))
    return PathBasis(h, values, slopes, np.zeros_like(values))


def piece_nodes(pieces: int) -> Array:
    """Return the Gauss nodes of equal pieces of [0, 1], (8 pieces,)."""
    return np.asarray((np.arange(pieces)[:, None] + nodes()).ravel() / pieces)


class PathLift(NamedTuple):
    """The lift of a path, and what it was made of.

    x, slope: (N, m) shapes and x′.  pose: (size,).  twist: (r, K, m), g⁻¹∂g by coefficients.
    square: (N,) x′ᵀMx′.  square_slopes: (N, 2m) by (x, x′); NaN and (N, 0) without a metric.
    """

    x: Array
    slope: Array
    pose: Array
    twist: Array
    square: Array
    square_slopes: Array


def path_lift(
    connection: Connection, basis: PathBasis, coefficients: Array, drift: Drift | None = None
) -> PathLift:
    """Return the lift of the path with coefficients (K, m), and its derivatives.

    drift: of a momentum other than zero.
    Raises SingularInertiaError on singular shapes, NoConvergence if a piece is too long.
    """
    group, r = connection.group, connection.r
    x, slope = basis.values @ coefficients, basis.slopes @ coefficients
    xi, square = connection.horizontal(x, slope)
    S = connection.horizontal_slopes(x, slope)
    count, m = len(basis.h), connection.m
    inverse = np.zeros((0, r, r)) if drift is None else drift.inverse(x)
    on_way = Pieces(
        h=np.array(basis.h),
        a=in_space(group, xi).reshape(count, STAGES, 6),
        L=in_space_by_momenta(group, inverse).reshape(-1, STAGES, 6, 6),
    )
    found = lifted(group, on_way, np.zeros(r) if drift is None else drift.momentum)
    pose = found.path[-1].copy()
    adjoints, by_x = _adjoints(group, found.inner.reshape(-1, 7)), S[:, :r, :m]
    carried = basis.weights[:, None, None] * adjoints
    if drift is not None:
        mu = np.swapaxes(adjoints, 1, 2) @ drift.momentum
        by_x = by_x + drift.slopes(x, inverse, mu)
        carried = drift.carriers(group, basis.h, adjoints, inverse) @ carried
    twists = by_coefficients(basis, carried @ by_x, carried @ S[:, :r, m:])
    twist = np.tensordot(group.Ad(group.inverse(pose)), twists, 1)
    return PathLift(x, slope, pose, twist, square, S[:, r] if S.shape[1] > r else S[:, 0, :0])


def by_coefficients(basis: PathBasis, *rows: Array) -> Array:
    """Return the sums over the nodes of rows (N, k, m), as (k, K, m).

    rows: weighted derivatives by x, by x′, and, if given, by x″.
    """
    kinds = (basis.values, basis.slopes, basis.bends)
    total = sum(np.tensordot(kind.T, each, 1) for kind, each in zip(kinds, rows, strict=False))
    return np.asarray(np.swapaxes(total, 0, 1))


def _adjoints(group: Group, inner: Array) -> Array:
    """Return Ad_g (N, r, r) of positions and quaternions (N, 7)."""
    linear = inner[:, list(group.axes[: group.linear])]
    q = inner[:, 3:] / np.linalg.norm(inner[:, 3:], axis=1, keepdims=True)
    if group.turns == 3:
        return group.Ad(np.concatenate([linear, q], axis=1))
    angle = 2.0 * np.arctan2(q[:, 2:3], q[:, 3:])
    return group.Ad(np.concatenate([linear, angle], axis=1) if group.turns else linear)
