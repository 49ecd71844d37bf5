"""The lift of a path in shape space to the group, by Gauss's method of order 16.

Body velocities are given at the eight Gauss nodes of every piece of the path, as twists of space
(v, ω): every group here is a part of SE(3).  The unit quaternion q and the position p obey

    q̇ = ½ q ω,   ṗ = R(q) v,   (v, ω) = a + L μ,   μ = Ad_gᵀ J,

with a = −A ẋ, and L = P_b⁻¹ where there is a spatial momentum J.  The collocation equations of a
piece are solved by fixed-point iteration; q is made a unit at the end of each piece.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...common.arrays import Array
from ...common.errors import NoConvergence
from ...integrators.gauss.tables import tables
from ...integrators.stepping.compiling import compiled
from ...lie.group import Group

STAGES = 8
_MOST = 80  # iterations of one piece
_ROUND_OFF = 4e-16


@dataclass(frozen=True)
class Pieces:
    """A path in pieces with its body velocities at their Gauss nodes.

    h: (P,) length of each piece [s].  a: (P, 8, 6) twists of space.  L: (P, 8, 6, 6) twists by
    momenta, or (0, 8, 6, 6) where there is none.
    """

    h: Array
    a: Array
    L: Array


def nodes() -> Array:
    """Gauss nodes in [0, 1], (8,)."""
    return tables(STAGES).c


def in_space(group: Group, twists: Array) -> Array:
    """Return twists (..., r) of a group as twists of space, (..., 6)."""
    out = np.zeros((*twists.shape[:-1], 6))
    out[..., list(group.axes)] = twists
    return out


def in_space_by_momenta(group: Group, inverse: Array) -> Array:
    """Return P_b⁻¹ (..., r, r) as twists of space by momenta of space, (..., 6, 6)."""
    axes = list(group.axes)
    out = np.zeros((*inverse.shape[:-2], 6, 6))
    out[..., np.array(axes)[:, None], axes] = inverse
    return out


class Lifted(NamedTuple):
    """Poses on the way, from the identity.

    path: (P + 1, size) at the ends of the pieces.  inner: (P, 8, 7) positions and quaternions, of
    no particular length, at their Gauss nodes.
    """

    path: Array
    inner: Array


def lift(group: Group, pieces: Pieces, J: Array) -> Array:
    """Return the path of `lifted` alone."""
    return lifted(group, pieces, J).path


def lifted(group: Group, pieces: Pieces, J: Array) -> Lifted:
    """Return the poses at the ends of pieces and at their nodes, from the identity.

    J: (r,) spatial momentum.

    Raises NoConvergence if a piece is too long: the body turns too far in it.
    """
    table, count = tables(STAGES), len(pieces.h)
    out, angle = np.zeros((count + 1, 7)), np.zeros(count + 1)
    out[0, 6] = 1.0
    inner, work = np.empty((count, STAGES, 7)), np.empty((2, STAGES, 7))
    coefficients = np.ascontiguousarray(table.mu * table.b)
    stopped = _lift(
        pieces.h,
        pieces.a,
        pieces.L,
        in_space(group, J),
        coefficients,
        table.b,
        out,
        angle,
        inner,
        work,
    )
    if stopped >= 0:
        raise NoConvergence(
            f"the lift of piece {stopped} of {count} did not converge: the body turns far in it",
            float(pieces.h[:stopped].sum()), out[max(stopped - 1, 0)].copy(),
        )  # fmt: skip
    return Lifted(_poses(group, out, angle), inner)


def travelled(pieces: Pieces) -> tuple[float, float]:
    """Return ∫|ω| dt [rad] and ∫|v| dt [m] at zero momentum: how far the body goes, all in all."""
    weights = pieces.h[:, None] * tables(STAGES).b
    turned, moved = (
        np.linalg.norm(part, axis=-1) for part in (pieces.a[..., 3:], pieces.a[..., :3])
    )
    return float((weights * turned).sum()), float((weights * moved).sum())


def _poses(group: Group, out: Array, angle: Array) -> Array:
    """Return poses (..., size) of positions and quaternions (..., 7), and unwrapped angles."""
    linear = out[:, list(group.axes[: group.linear])]
    if group.turns == 3:
        return np.concatenate([linear, out[:, 3:]], axis=1)
    return np.concatenate([linear, angle[:, None]], axis=1) if group.turns else linear


@compiled
def _lift(
    h: Array, a: Array, L: Array, J: Array, A: Array, b: Array, out: Array, angle: Array,
    inner: Array, work: Array,
) -> int:  # fmt: skip
    """Fill poses and angles; return −1, or the piece that did not converge."""
    stages = len(b)
    F, W = work[0], work[1]  # slopes of (p, q); twists
    moving = len(L) > 0
    for piece in range(len(h)):
        Y = inner[piece]
        for i in range(stages):
            for k in range(7):
                Y[i, k] = out[piece, k]
        done = False
        for _ in range(_MOST):
            for i in range(stages):
                x, y, z, w = Y[i, 3], Y[i, 4], Y[i, 5], Y[i, 6]
                for k in range(6):
                    W[i, k] = a[piece, i, k]
                n = 1.0 / (x * x + y * y + z * z + w * w)
                r00, r11 = 1.0 - 2.0 * n * (y * y + z * z), 1.0 - 2.0 * n * (x * x + z * z)
                r22 = 1.0 - 2.0 * n * (x * x + y * y)
                r01, r10 = 2.0 * n * (x * y - w * z), 2.0 * n * (x * y + w * z)
                r02, r20 = 2.0 * n * (x * z + w * y), 2.0 * n * (x * z - w * y)
                r12, r21 = 2.0 * n * (y * z - w * x), 2.0 * n * (y * z + w * x)
                if moving:
                    # μ = Ad_gᵀ J: force Rᵀ F, moment Rᵀ (N − p × F).
                    n0 = J[3] - (Y[i, 1] * J[2] - Y[i, 2] * J[1])
                    n1 = J[4] - (Y[i, 2] * J[0] - Y[i, 0] * J[2])
                    n2 = J[5] - (Y[i, 0] * J[1] - Y[i, 1] * J[0])
                    m0 = r00 * J[0] + r10 * J[1] + r20 * J[2]
                    m1 = r01 * J[0] + r11 * J[1] + r21 * J[2]
                    m2 = r02 * J[0] + r12 * J[1] + r22 * J[2]
                    m3 = r00 * n0 + r10 * n1 + r20 * n2
                    m4 = r01 * n0 + r11 * n1 + r21 * n2
                    m5 = r02 * n0 + r12 * n1 + r22 * n2
                    for k in range(6):
                        row = L[piece, i, k]
                        W[i, k] += (
                            row[0] * m0 + row[1] * m1 + row[2] * m2
                            + row[3] * m3 + row[4] * m4 + row[5] * m5
                        )  # fmt: skip
                u, v, s = W[i, 0], W[i, 1], W[i, 2]
                p, q, r = 0.5 * W[i, 3], 0.5 * W[i, 4], 0.5 * W[i, 5]
                F[i, 0] = r00 * u + r01 * v + r02 * s
                F[i, 1] = r10 * u + r11 * v + r12 * s
                F[i, 2] = r20 * u + r21 * v + r22 * s
                F[i, 3] = w * p + y * r - z * q
                F[i, 4] = w * q + z * p - x * r
                F[i, 5] = w * r + x * q - y * p
                F[i, 6] = -(x * p + y * q + z * r)
            change, size = 0.0, 1.0
            for i in range(stages):
                for k in range(7):
                    new = 0.0
                    for j in range(stages):
                        new += A[i, j] * F[j, k]
                    new = out[piece, k] + h[piece] * new
                    change = max(change, abs(new - Y[i, k]))
                    size = max(size, abs(new))
                    Y[i, k] = new
            if not change < 1e300:
                return piece
            # The slopes lag behind the values by one iteration, which contracts once more.
            if change <= _ROUND_OFF * size:
                done = True
                break
        if not done and not change <= 64.0 * _ROUND_OFF * size:
            return piece
        turned = 0.0
        for k in range(7):
            new = 0.0
            for j in range(stages):
                new += b[j] * F[j, k]
            out[piece + 1, k] = out[piece, k] + h[piece] * new
        for j in range(stages):
            turned += b[j] * W[j, 5]
        angle[piece + 1] = angle[piece] + h[piece] * turned
        norm = 0.0
        for k in range(3, 7):
            norm += out[piece + 1, k] * out[piece + 1, k]
        norm = 1.0 / np.sqrt(norm)
        for k in range(3, 7):
            out[piece + 1, k] *= norm
    return -1
