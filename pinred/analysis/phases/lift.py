"""The lift of a path in shape space to the group, computed with Gauss's method of order 16.

Body twists are given at the eight Gauss nodes of every segment, as spatial twists (v, ω), because
every group is a subgroup of SE(3). The unit quaternion q and the position p obey

    q̇ = ½ q ω,   ṗ = R(q) v,   (v, ω) = a + L μ,   μ = Ad_gᵀ J,

with a = −A ẋ. If there is a spatial momentum J, then L = P_b⁻¹. Fixed-point iteration solves the
collocation equations of a segment, and q is normalised at its end.

A path that depends linearly on coefficients is x(s) = Σ_k Φ_k(s) c_k for s in [0, 1]. A variation
of ġ = g ξ gives, at the end, g⁻¹δg = Ad_{g⁻¹} ∫ Ad_{g(s)} δξ ds. Compiled code computes δξ =
(∂ξ/∂x) δx + (∂ξ/∂x′) δx′. `phase_slopes` applies this to the Fourier coefficients of a gait.

With a spatial momentum J, ξ = −A x′ + I⁻¹μ and μ = Ad_gᵀ J. A variation η = δg g⁻¹ of such a motion
obeys η′ = Ad_g δξ + K η, with δξ at fixed g and K η = Ad_g I⁻¹ Ad_gᵀ ad_ηᵀ J.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, FrozenArrays, whole
from ...common.errors import NoConvergence
from ...common.waiting import Wait
from ...integrators.implicit.gauss_stages import tables
from ...integrators.stepping.compiling import compiled
from ...kernels.connection.connection_code import ConnectionCode
from ...lie.group import Group
from ..connections.connection import Connection, ConnectionSource, connection_of
from .gait import Gait

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


_MOST_PIECES = 10**6
_PER_HARMONIC = 8  # default number of segments per harmonic


@dataclass(frozen=True, eq=False)
class Drift(FrozenArrays):
    """The drift twist I⁻¹μ of a free system with constant spatial momentum.

    Attributes:
        code: Mechanical connection of a system without external wrench.
        momentum: Spatial momentum J, (r,), in the initial frame of the base. For a path of duration
            T that is parametrised over [0, 1], this is T J.
    """

    code: ConnectionCode
    momentum: Array

    def inverse(self, x: Array) -> Array:
        """Compute the inverse locked inertia I⁻¹.

        Args:
            x: Shapes, (N, m).
        Returns:
            (N, r, r).
        """
        return np.asarray(np.linalg.inv(self.code.locals(x).P))

    def slopes(self, x: Array, inverse: Array, mu: Array) -> Array:
        """Compute the shape derivative of the drift, ∂(I⁻¹μ)/∂x = −I⁻¹ ∂I I⁻¹μ, at fixed μ.

        Args:
            x: Shapes, (N, m).
            inverse: I⁻¹ at these shapes, (N, r, r).
            mu: Body momenta, (N, r).
        Returns:
            (N, r, m).
        """
        omega = (inverse @ mu[..., None])[..., 0]
        return np.asarray(-inverse @ self.code.locked_derivatives(x, omega))

    def carriers(self, group: Group, h: Array, adjoints: Array, inverse: Array) -> Array:
        """Compute the propagators Ψ of variations, η(end) = Ψ η(node).

        They obey Ψ′ = −Ψ K, which is solved backward by Gauss's method of order 16.

        Args:
            group: Symmetry group.
            h: Lengths of the P segments, (P,).
            adjoints: Ad_g at the N = 8 P Gauss nodes, (N, r, r).
            inverse: I⁻¹ at the nodes, (N, r, r).
        Returns:
            (N, r, r).
        """
        count, r, table = len(h), self.code.form.r, tables(STAGES)
        co = np.swapaxes(group.ad(np.eye(r)), 1, 2) @ self.momentum  # row e: ad_eᵀ J
        coadjoints = np.swapaxes(adjoints, 1, 2)
        K = (adjoints @ inverse @ coadjoints @ co.T).reshape(count, STAGES, r, r)
        # Integrate from the end of a segment: Y_iᵀ = 1 + h Σ_j (b_j − a_ij) K_jᵀ Y_jᵀ.
        backward_weights = table.b - table.mu * table.b
        scaled_K = h[:, None, None, None] * np.moveaxis(K, 3, 1)  # h K_jᵀ, (P, r, 8, r)
        blocks = backward_weights[None, :, None, :, None] * scaled_K[:, None]
        size = STAGES * r
        stages = np.linalg.solve(
            np.eye(size) - blocks.reshape(count, size, size),
            np.broadcast_to(np.tile(np.eye(r), (STAGES, 1)), (count, size, r)),
        ).reshape(count, STAGES, r, r)
        node_propagators = np.swapaxes(stages, 2, 3)
        weights = h[:, None, None, None] * table.b[:, None, None]
        segment_propagators = np.eye(r) + (weights * (node_propagators @ K)).sum(axis=1)
        propagators, to_end = np.empty((count, STAGES, r, r)), np.eye(r)
        for p in range(count - 1, -1, -1):
            propagators[p] = to_end @ node_propagators[p]
            to_end = to_end @ segment_propagators[p]
        return propagators.reshape(-1, r, r)


@dataclass(frozen=True, eq=False)
class PathBasis(FrozenArrays):
    """Basis functions Φ at the N = 8 P Gauss nodes of P segments.

    Attributes:
        h: Lengths of the segments in s, (P,).
        values: Φ, (N, K).
        slopes: Φ′, (N, K).
        bends: Φ″, (N, K).
    """

    h: Array
    values: Array
    slopes: Array
    bends: Array

    @property
    def weights(self) -> Array:
        """Quadrature weights of the nodes for integrals over s, (N,)."""
        return np.asarray((self.h[:, None] * tables(STAGES).b).ravel())


def fourier_basis(
    harmonics: int, pieces: int, *, start: float = 0.0, turn: float = 2.0 * np.pi
) -> PathBasis:
    """Evaluate 1, cos kφ, sin kφ for k = 1 … harmonics, with φ = start + turn s.

    Args:
        harmonics: Number of harmonics; K = 1 + 2 harmonics.
        pieces: Number of segments.
        start: Initial phase angle [rad].
        turn: Change of the phase angle [rad].
    Returns:
        The basis at the Gauss nodes.
    """
    values, slopes, bends = fourier_rows(harmonics, piece_nodes(pieces), start=start, turn=turn)
    return PathBasis(np.full(pieces, 1.0 / pieces), values, slopes, bends)


def cycloid_basis(harmonics: int, pieces: int, cycles: int) -> PathBasis:
    """Evaluate the Fourier basis along a cycloid, φ = cycles (a − sin a) with a = 2πs.

    The path is traversed from rest to rest.

    Args:
        harmonics: Number of harmonics.
        pieces: Number of segments.
        cycles: Number of cycles for s in [0, 1].
    Returns:
        The basis at the Gauss nodes.
    """
    s = piece_nodes(pieces)
    angle, rate, bend = cycloid(s, cycles)
    values, slopes, bends = fourier_rows(harmonics, angle, turn=1.0)
    return PathBasis(
        np.full(pieces, 1.0 / pieces), values, rate[:, None] * slopes,
        rate[:, None] ** 2 * bends + bend[:, None] * slopes,
    )  # fmt: skip


def cycloid(s: Array, cycles: int) -> tuple[Array, Array, Array]:
    """Return φ = cycles (a − sin a) with a = 2πs, and its first two derivatives by s, (N,) each."""
    a = 2.0 * np.pi * s
    return (
        cycles * (a - np.sin(a)),
        2.0 * np.pi * cycles * (1.0 - np.cos(a)),
        (2.0 * np.pi) ** 2 * cycles * np.sin(a),
    )


def fourier_rows(
    harmonics: int, s: Array, *, start: float = 0.0, turn: float = 2.0 * np.pi
) -> tuple[Array, Array, Array]:
    """Evaluate 1, cos kφ, sin kφ and their first two derivatives in s, φ = start + turn s.

    Args:
        harmonics: Number of harmonics; K = 1 + 2 harmonics.
        s: Path parameters, (N,).
        start: Initial phase angle [rad].
        turn: Change of the phase angle [rad].
    Returns:
        Values, first and second derivatives, (N, K) each.
    """
    k = np.arange(1, harmonics + 1)
    angle, rate = np.multiply.outer(start + turn * s, k), turn * k
    cosines, sines, zero = np.cos(angle), np.sin(angle), np.zeros((len(s), 1))
    return (
        np.hstack([zero + 1.0, cosines, sines]),
        np.hstack([zero, -rate * sines, rate * cosines]),
        np.hstack([zero, -(rate**2) * cosines, -(rate**2) * sines]),
    )


def polygon_basis(corners: int, per_edge: int) -> PathBasis:
    """Evaluate the basis of a closed polygon, in which every edge spans an equal interval of s.

    Args:
        corners: Number of corners, K.
        per_edge: Number of segments per edge.
    Returns:
        The basis at the Gauss nodes.
    """
    edge_nodes = piece_nodes(per_edge)
    count = len(edge_nodes)
    values, slopes = np.zeros((2, corners * count, corners))
    for k in range(corners):
        edge = slice(k * count, (k + 1) * count)
        values[edge, k], values[edge, (k + 1) % corners] = 1.0 - edge_nodes, edge_nodes
        slopes[edge, k], slopes[edge, (k + 1) % corners] = -corners, corners
    h = np.full(corners * per_edge, 1.0 / (corners * per_edge))
    return PathBasis(h, values, slopes, np.zeros_like(values))


def piece_nodes(pieces: int) -> Array:
    """Return the Gauss nodes of equal segments of [0, 1], (8 pieces,)."""
    return np.asarray((np.arange(pieces)[:, None] + nodes()).ravel() / pieces)


class PathLift(NamedTuple):
    """The lift of a path and its derivatives.

    Attributes:
        x: Shapes at the Gauss nodes, (N, m).
        slope: Derivatives x′, (N, m).
        pose: Final pose, (size,).
        twist: Derivative of the pose with respect to the coefficients, g⁻¹∂g, (r, K, m).
        square: Squared speed x′ᵀ M x′ in the metric M, (N,).
        square_slopes: Derivatives of the square with respect to (x, x′), (N, 2m).
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
    """Compute the lift of a path and its derivatives with respect to the coefficients.

    Args:
        connection: Connection that lifts the path.
        basis: Basis functions at the Gauss nodes.
        coefficients: Coefficients of the path, (K, m).
        drift: Drift of a system with non-zero momentum; None at zero momentum.
    Returns:
        The lift with its derivatives.
    Raises:
        SingularInertiaError: The path meets a singular shape.
        NoConvergence: The base rotates too far within a segment.
    """
    group, r = connection.group, connection.r
    x, slope = basis.values @ coefficients, basis.slopes @ coefficients
    xi, square = connection.horizontal(x, slope)
    S = connection.horizontal_slopes(x, slope)
    count, m = len(basis.h), connection.m
    inverse = np.zeros((0, r, r)) if drift is None else drift.inverse(x)
    segments = PathSegments(
        h=np.array(basis.h),
        a=in_space(group, xi).reshape(count, STAGES, 6),
        L=in_space_by_momenta(group, inverse).reshape(-1, STAGES, 6, 6),
    )
    lift_poses = lifted(group, segments, np.zeros(r) if drift is None else drift.momentum)
    pose = lift_poses.path[-1].copy()
    adjoints, by_x = _adjoints(group, lift_poses.inner.reshape(-1, 7)), S[:, :r, :m]
    propagated = basis.weights[:, None, None] * adjoints
    if drift is not None:
        mu = np.swapaxes(adjoints, 1, 2) @ drift.momentum
        by_x = by_x + drift.slopes(x, inverse, mu)
        propagated = drift.carriers(group, basis.h, adjoints, inverse) @ propagated
    twists = by_coefficients(basis, propagated @ by_x, propagated @ S[:, :r, m:])
    twist = np.tensordot(group.Ad(group.inverse(pose)), twists, 1)
    return PathLift(x, slope, pose, twist, square, S[:, r] if S.shape[1] > r else S[:, 0, :0])


def by_coefficients(basis: PathBasis, *rows: Array) -> Array:
    """Convert derivatives at the nodes to derivatives with respect to the coefficients.

    Args:
        basis: Basis functions at the N nodes.
        rows: Weighted derivatives (N, k, m) with respect to x, x′ and, optionally, x″.
    Returns:
        (k, K, m).
    """
    bases = (basis.values, basis.slopes, basis.bends)
    used = [functions.T for functions, _ in zip(bases, rows, strict=False)]
    total = np.hstack(used) @ np.concatenate(rows).reshape(-1, rows[0].shape[1] * rows[0].shape[2])
    return np.asarray(np.swapaxes(total.reshape(-1, *rows[0].shape[1:]), 0, 1))


def sum_over_nodes(basis: PathBasis, m: int, derivatives: Array) -> Array:
    """Convert derivatives of a scalar at the nodes to derivatives with respect to the coefficients.

    Args:
        basis: Basis functions at the N nodes.
        m: Number of joints.
        derivatives: Weighted derivatives with respect to (x, x′), (N, 2m), or (x, x′, x″), (N, 3m).
    Returns:
        (K, m).
    """
    blocks = [derivatives[:, None, k : k + m] for k in range(0, derivatives.shape[1], max(m, 1))]
    return np.asarray(by_coefficients(basis, *blocks)[0])


def _adjoints(group: Group, inner: Array) -> Array:
    """Compute Ad_g, (N, r, r), from positions and quaternions (N, 7)."""
    linear = inner[:, list(group.axes[: group.linear])]
    q = inner[:, 3:] / np.linalg.norm(inner[:, 3:], axis=1, keepdims=True)
    if group.turns == 3:
        return group.Ad(np.concatenate([linear, q], axis=1))
    angle = 2.0 * np.arctan2(q[:, 2:3], q[:, 3:])
    return group.Ad(np.concatenate([linear, angle], axis=1) if group.turns else linear)


@checks_arguments
@dataclass(frozen=True)
class PhaseSlopes(FrozenArrays):
    """Phase and effort of a Fourier gait at zero momentum, with derivatives.

    The coefficients are (1 + 2 harmonics, m): mean, cosines, sines.

    Attributes:
        pose: Pose after one cycle, (size,).
        twist: Derivative of the pose, g⁻¹∂g, (r, 1 + 2 harmonics, m).
        length: Length of the path, ∫√(ẋᵀMẋ) dt; NaN if the connection has no metric.
        length_slope: Derivative of the length, (1 + 2 harmonics, m).
        action: Action of the gait, ∫ẋᵀMẋ dt; NaN if the connection has no metric.
        action_slope: Derivative of the action, (1 + 2 harmonics, m).
    """

    pose: Array
    twist: Array
    length: float
    length_slope: Array
    action: float
    action_slope: Array


@checks_arguments
@Wait("computes derivatives of a phase")
def phase_slopes(
    connection: ConnectionSource, gait: Gait, *, pieces: int | None = None
) -> PhaseSlopes:
    """Compute the phase and the effort of a Fourier gait, and their derivatives.

    Args:
        connection: Connection that lifts the gait, or a System for its mechanical connection.
        gait: Gait that is one Fourier series.
        pieces: Number of segments of order 16; by default eight per harmonic.
    Returns:
        Values and derivatives.
    Raises:
        InputError: The gait is not one Fourier series, or the number of segments is invalid.
    """
    connection = connection_of(connection, "phase_slopes").in_chart()
    connection.refuse_gravity()
    arc = gait.series
    harmonics, m = len(arc.cos), connection.m
    count = _PER_HARMONIC * (harmonics + 1)
    if pieces is not None:
        count = whole(pieces, "pieces", most=_MOST_PIECES)
    basis = fourier_basis(harmonics, count, start=arc.start, turn=arc.end - arc.start)
    lift = path_lift(connection, basis, np.vstack([arc.mean[None], arc.cos, arc.sin]))
    length = action = np.nan
    length_slope = action_slope = np.full((1 + 2 * harmonics, m), np.nan)
    if connection.has_metric:
        speed, weights = np.sqrt(lift.square), basis.weights
        length, action = float(weights @ speed), float(weights @ lift.square) / arc.time
        with np.errstate(divide="ignore", invalid="ignore"):
            factors = np.where(speed > 0.0, 0.5 / speed, 0.0)
        slopes = lift.square_slopes
        length_slope = sum_over_nodes(basis, m, (weights * factors)[:, None] * slopes)
        action_slope = sum_over_nodes(basis, m, weights[:, None] * slopes) / arc.time
    return PhaseSlopes(lift.pose, lift.twist, length, length_slope, action, action_slope)
