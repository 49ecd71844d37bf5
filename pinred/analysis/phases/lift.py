"""The lift of a path in shape space to the group, computed with Gauss's method of order 16.

Body twists are given at the eight Gauss nodes of every segment, as spatial twists (v, ω), because
every group is a subgroup of SE(3). The unit quaternion q and the position p obey

    q̇ = ½ q ω,   ṗ = R(q) v,   (v, ω) = a + L μ,   μ = Ad_gᵀ J,

with a = −A ẋ. If there is a spatial momentum J, then L = P_b⁻¹. Fixed-point iteration solves the
collocation equations of a segment, and q is normalised at its end.
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
_MAX_ITERATIONS = 80  # largest number of fixed-point iterations per segment
_ROUND_OFF = 4e-16


@dataclass(frozen=True)
class PathSegments:
    """A path divided into segments, with body twists at the Gauss nodes of every segment.

    Attributes:
        h: Duration of each segment, (P,) [s].
        a: Twists −A ẋ, (P, 8, 6).
        L: Body twist per unit of body momentum, P_b⁻¹, (P, 8, 6, 6), or (0, 8, 6, 6) at zero
            momentum.
    """

    h: Array
    a: Array
    L: Array


def nodes() -> Array:
    """Return the Gauss nodes in [0, 1], (8,)."""
    return tables(STAGES).c


def in_space(group: Group, twists: Array) -> Array:
    """Embed twists (..., r) of a group as spatial twists, (..., 6)."""
    spatial = np.zeros((*twists.shape[:-1], 6))
    spatial[..., list(group.axes)] = twists
    return spatial


def in_space_by_momenta(group: Group, inverse: Array) -> Array:
    """Embed P_b⁻¹ (..., r, r) as a map from spatial momenta to spatial twists, (..., 6, 6)."""
    axes = list(group.axes)
    spatial = np.zeros((*inverse.shape[:-2], 6, 6))
    spatial[..., np.array(axes)[:, None], axes] = inverse
    return spatial


class Lifted(NamedTuple):
    """Poses along a path that starts at the identity.

    Attributes:
        path: Poses at the segment ends, (P + 1, size).
        inner: Positions and unnormalised quaternions at the Gauss nodes, (P, 8, 7).
    """

    path: Array
    inner: Array


def lift(group: Group, segments: PathSegments, J: Array) -> Array:
    """Compute the poses at the segment ends (see `lifted`).

    Args:
        group: Symmetry group.
        segments: Body twists along the path.
        J: Spatial momentum, (r,).
    Returns:
        Pose coordinates at the segment ends, (P + 1, size).
    """
    return lifted(group, segments, J).path


def lifted(group: Group, segments: PathSegments, J: Array) -> Lifted:
    """Compute the poses at the segment ends and at the Gauss nodes, starting at the identity.

    Args:
        group: Symmetry group.
        segments: Body twists along the path.
        J: Spatial momentum, (r,).
    Returns:
        The poses along the path.
    Raises:
        NoConvergence: The base rotates too far within a segment.
    """
    table, count = tables(STAGES), len(segments.h)
    poses, angle = np.zeros((count + 1, 7)), np.zeros(count + 1)
    poses[0, 6] = 1.0
    inner, work = np.empty((count, STAGES, 7)), np.empty((2, STAGES, 7))
    coefficients = np.ascontiguousarray(table.mu * table.b)
    stopped = _lift(
        segments.h,
        segments.a,
        segments.L,
        in_space(group, J),
        coefficients,
        table.b,
        poses,
        angle,
        inner,
        work,
    )
    if stopped >= 0:
        raise NoConvergence(
            f"the lift of segment {stopped} of {count} did not converge: the base rotates too far",
            float(segments.h[:stopped].sum()), poses[max(stopped - 1, 0)].copy(),
        )  # fmt: skip
    return Lifted(_poses(group, poses, angle), inner)


def _poses(group: Group, out: Array, angle: Array) -> Array:
    """Convert positions and quaternions (..., 7), and unwrapped angles, to poses (..., size)."""
    linear = out[:, list(group.axes[: group.linear])]
    if group.turns == 3:
        return np.concatenate([linear, out[:, 3:]], axis=1)
    return np.concatenate([linear, angle[:, None]], axis=1) if group.turns else linear


@compiled
def _lift(
    h: Array, a: Array, L: Array, J: Array, A: Array, b: Array, out: Array, angle: Array,
    inner: Array, work: Array,
) -> int:  # fmt: skip
    """Write poses and angles to `out` and `angle`; return a failing segment's index, or −1."""
    stages = len(b)
    F, W = work[0], work[1]  # rates of (p, q); twists
    moving = len(L) > 0
    for segment in range(len(h)):
        Y = inner[segment]
        for i in range(stages):
            for k in range(7):
                Y[i, k] = out[segment, k]
        done = False
        for _ in range(_MAX_ITERATIONS):
            for i in range(stages):
                x, y, z, w = Y[i, 3], Y[i, 4], Y[i, 5], Y[i, 6]
                for k in range(6):
                    W[i, k] = a[segment, i, k]
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
                        row = L[segment, i, k]
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
            change, size, finite = 0.0, 1.0, 0.0
            for i in range(stages):
                for k in range(7):
                    new = 0.0
                    for j in range(stages):
                        new += A[i, j] * F[j, k]
                    new = out[segment, k] + h[segment] * new
                    change = max(change, abs(new - Y[i, k]))
                    size = max(size, abs(new))
                    finite += new - new  # NaN for infinities and NaN, which `max` ignores
                    Y[i, k] = new
            if finite != 0.0:
                return segment
            # The rates are one iteration behind the values, so evaluating them contracts the error
            # again.
            if change <= _ROUND_OFF * size:
                done = True
                break
        if not done and not change <= 64.0 * _ROUND_OFF * size:
            return segment
        rotation = 0.0
        for k in range(7):
            new = 0.0
            for j in range(stages):
                new += b[j] * F[j, k]
            out[segment + 1, k] = out[segment, k] + h[segment] * new
        for j in range(stages):
            rotation += b[j] * W[j, 5]
        angle[segment + 1] = angle[segment] + h[segment] * rotation
        norm = 0.0
        for k in range(3, 7):
            norm += out[segment + 1, k] * out[segment + 1, k]
        norm = 1.0 / np.sqrt(norm)
        for k in range(3, 7):
            out[segment + 1, k] *= norm
    return -1
