"""Paths that depend linearly on coefficients, and the derivatives of their lift.

x(s) = Σ_k Φ_k(s) c_k for s in [0, 1]. A variation of ġ = g ξ gives, at the end,
g⁻¹δg = Ad_{g⁻¹} ∫ Ad_{g(s)} δξ ds. Compiled code computes δξ = (∂ξ/∂x) δx + (∂ξ/∂x′) δx′.
`phase_slopes` applies this to the Fourier coefficients of a gait.

With a spatial momentum J, ξ = −A x′ + I⁻¹μ and μ = Ad_gᵀ J. A variation η = δg g⁻¹ of such a motion
obeys η′ = Ad_g δξ + K η, with δξ at fixed g and K η = Ad_g I⁻¹ Ad_gᵀ ad_ηᵀ J.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, FrozenArrays, whole
from ...common.waiting import Wait
from ...integrators.gauss.tables import tables
from ...kernels.connection.connection_code import ConnectionCode
from ...lie.group import Group
from ..connections.connection import Connection, ConnectionSource, connection_of
from ..gaits.gait import Gait
from .lift import STAGES, PathSegments, in_space, in_space_by_momenta, lifted, nodes

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
