"""Surface integrals of the curvature, compared with the phase.

If the group were commutative, the phase would be exp(−∬B) by Stokes' theorem. For other groups, the
error of this approximation depends on the frame of the curvature.

Minimum-perturbation coordinates: the body frame that gaits move least.

In a frame h(x) the connection is A′ = Ad_{h⁻¹}A − h⁻¹∂h. With h = (R, p),

    A′_ω = Rᵀ (A_ω − (∂R Rᵀ)^∨),   A′_v = Rᵀ (A_v + A_ω × p − ∂p),

so the best R does not depend on p, and the best p does not depend on R. Both minimise ∫|A′|² over a
patch among polynomials of its parameters. R solves Poisson's equation (once in the plane; in space
repeatedly, with R ← R exp φ), and p is a linear least-squares solution. Source: R. Hatton, H.
Choset, "Geometric motion planning: the local connection, Stokes' theorem, and the importance of
coordinate choice", Int. J. Robotics Research 30 (2011); for SO(3), Faraji et al.

On a box the least norms decrease with a power of the degree, because the derivatives of φ have
singularities at the corners. The degree is raised until the estimated rest is small.

Distance of the norms of polynomial frames from their limit, by extrapolation in the degree.

A patch is a smooth map from k parameters to shapes, with quadrature nodes and weights. Frames on it
are polynomials of the parameters.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike, NDArray

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, FrozenArrays, as_floats, freeze, read_only, vector, vectors
from ...common.errors import InputError, NoConvergence
from ...common.html import Rows, Summary
from ...common.waiting import Wait
from ...lie.group import Group
from ...lie.rotations import hat, quaternion_exp, quaternion_product, rotation
from ..connections.connection import Connection, ConnectionSource, connection_of
from .gait import Gait
from .lift import in_space
from .phase import phase

_ROUND_OFF = 1e-13  # changes below this part of the scale are round-off
# Range of the power with which norms converge. On a box it tends to 8 by the singularities at the
# corners, also if the first changes decrease faster.
_POWERS = (1.0, 8.0)


def norm_distance(degrees: Sequence[int], norms: Sequence[float], scale: float) -> float:
    """Estimate the distance of a norm from its limit, relative to a scale.

    Least norms decrease with the degree d like limit + C d^−q. The power q is that of the last two
    changes. If they do not decrease, it is the least power, so that the estimate is large. The
    distance of a norm is at most the norm itself.

    Args:
        degrees: Three increasing degrees.
        norms: Least norms of these degrees.
        scale: Scale of the result; if it is 0, so are the norms.
    Returns:
        The distance of the last norm, or inf if the degrees do not increase.
    """
    if not degrees[0] < degrees[1] < degrees[2]:
        return np.inf
    first, second = norms[0] - norms[1], norms[1] - norms[2]
    if not scale > 0.0 or max(abs(first), abs(second)) <= _ROUND_OFF * scale:
        return _ROUND_OFF
    second = max(abs(second), _ROUND_OFF * scale)
    a, b, c = np.asarray(degrees, dtype=float) / degrees[2]

    def ratio(q: float) -> float:
        """Return the first change divided by the second, which increases with q."""
        return float((a**-q - b**-q) / (b**-q - c**-q))

    low, high = _POWERS
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if ratio(middle) < first / second else (low, middle)
    return float(min(second / (b**-low - 1.0), norms[2]) / scale)


_DEGREES = {1: (20, 40), 2: (14, 30), 3: (6, 8)}  # first and last degree by number of parameters
# Difference of successive degrees; if it is even, symmetric patches change the norm at each step.
_STEPS = {1: 4, 2: 4, 3: 2}
_LEAST_NORM = 1e-2  # norms below this part of the norm of A count as this part
_GOAL = 1e-6  # estimated distance at which the degree is not raised further
_MORE_NODES = 6  # quadrature nodes per parameter beyond the polynomial degree
_ITERATIONS = 60  # largest number of iterations of the attitude R
_STILL = 1e-10  # relative change of ∫|A′_ω|² at which the iteration stops


@checks_arguments
@dataclass(frozen=True, eq=False)
class OptimalFrame:
    """The frame h(x) on the body that minimises ∫|A′|² over a patch of shape space.

    Attributes:
        connection: Connection in the base frame.
        patch: Patch of shape space.
        angular: Root mean square of the rotations of A′ over the patch [rad per parameter]; the
            parameters range over ±1.
        linear: Root mean square of the translations of A′ [m per parameter].
        angular_before: Root mean square of the rotations of A, in the same unit.
        linear_before: Root mean square of the translations of A, in the same unit.
        iterations: Number of iterations of the attitude R.
        degree: Degree of the polynomials.
        distance: Estimated distance of the norms `angular` and `linear` from those of the best
            frame of any degree, relative to these norms or to a hundredth of those of A. It is
            extrapolated from two lower degrees; inf for degrees below 3.
    """

    connection: Connection
    patch: Patch = field(repr=False)
    angular: float
    linear: float
    angular_before: float
    linear_before: float
    iterations: int
    degree: int
    distance: float
    _basis: Basis = field(repr=False)
    _turns: tuple[Array, ...] = field(repr=False)
    _shift: Array = field(repr=False)

    def pose(self, shapes: ArrayLike) -> Array:
        """Return the pose h(x) of the frame relative to the base.

        Args:
            shapes: Shapes on the patch, (..., m).
        Returns:
            (..., size).
        """
        connection = self.connection
        x = vectors(shapes, connection.m, "shapes", connection.joints)
        u = self.patch.parameters(x.reshape(-1, connection.m))
        return read_only(self.pose_at(u).reshape(*x.shape[:-1], connection.group.size))

    def pose_at(self, u: Array) -> Array:
        """Return the pose of the frame at parameters of the patch.

        Args:
            u: Parameters, (N, k).
        Returns:
            (N, size).
        """
        group = self.connection.group
        values = self._basis.values(u)
        linear = with_one(values) @ self._shift
        return np.concatenate([linear, _attitude(group, self._turns, values)], axis=1)

    def local(self, shapes: ArrayLike) -> Array:
        """Return A′ with respect to the parameters of the patch.

        Args:
            shapes: Shapes on the patch, (..., m).
        Returns:
            (..., r, k).
        """
        connection = self.connection
        x = vectors(shapes, connection.m, "shapes", connection.joints)
        u = self.patch.parameters(x.reshape(-1, connection.m))
        return read_only(self.local_at(u).reshape(*x.shape[:-1], connection.r, self.patch.k))

    def local_at(self, u: Array) -> Array:
        """Return A′ with respect to the parameters of the patch, at parameter values.

        Args:
            u: Parameters, (N, k).
        Returns:
            (N, r, k).
        """
        group = self.connection.group
        A = pulled_back(self.connection, self.patch, u)
        values, slopes = self._basis.values(u), self._basis.slopes(u)
        p, dp = with_one(values) @ self._shift, _slope_of(slopes, self._shift)
        n = group.linear
        angular = _turned(group, A[:, n:], self._turns, values, slopes)
        linear = A[:, :n] + _across(group, A[:, n:], p) - dp
        R = _rotation(group, self._turns, values)
        return np.concatenate([np.swapaxes(R, 1, 2) @ linear if n else linear, angular], axis=1)


@checks_arguments
@Wait("computes an optimal frame")
def optimal_frame(
    connection: ConnectionSource,
    limits: ArrayLike | Gait,
    *,
    joints: Sequence[int] | None = None,
    at: ArrayLike | None = None,
    degree: int | None = None,
    nodes: int | None = None,
) -> OptimalFrame:
    """Compute the minimum-perturbation frame over a box of joints or the disc of a gait.

    Args:
        connection: Connection in the base frame, or a System for its mechanical connection.
        limits: (low, high) of one to three joints, (k, 2); or a Fourier gait, for any number of
            joints.
        joints: Indices of the joints that vary; by default the first ones.
        at: Values of the other joints, (m,).
        degree: Degree of the polynomials; by default it is raised until the estimated distance from
            the best frame is below 1e-6, or up to 40, 30 and 8 for one, two and three parameters.
        nodes: Quadrature nodes per parameter of a box.
    Returns:
        The frame, with the remaining perturbation.
    Raises:
        InputError: Limits, joints or gait are invalid.
        SingularInertiaError: A is undefined on the patch.
        NoConvergence: The iteration of the attitude does not converge.
    """
    connection = connection_of(connection, "optimal_frame").in_chart()
    if isinstance(limits, Gait):
        if joints is not None or at is not None or nodes is not None:
            raise InputError("joints, at and nodes apply to a box of joint limits, not to a gait")
        disc = Disc(limits)
        return _converged(lambda order: _frame_of(connection, disc, order), disc.k, degree)

    def over_box(order: int) -> OptimalFrame:
        patch = box_of(connection.m, limits, joints, at, nodes or order + _MORE_NODES)
        return _frame_of(connection, patch, order)

    count = min(len(np.atleast_1d(as_floats(limits, "limits"))), 3)
    return _converged(over_box, count, degree)


def _converged(
    frame_of: Callable[[int], OptimalFrame], parameters: int, degree: int | None
) -> OptimalFrame:
    """Return the frame of a degree, or of the first degree that converged, with its distance.

    Args:
        frame_of: Function that returns the frame of a degree.
        parameters: Number of parameters of the patch.
        degree: The degree; None to raise it.
    Returns:
        The frame.
    """
    step = _STEPS[parameters]
    first, last = _DEGREES[parameters] if degree is None else (int(degree), int(degree))
    frames = [frame_of(max(first - k * step, 1)) for k in (2, 1, 0)]
    while True:
        distance = max(
            norm_distance(
                [frame.degree for frame in frames], norms, max(norms[-1], _LEAST_NORM * before)
            )
            for norms, before in (
                ([frame.angular for frame in frames], frames[0].angular_before),
                ([frame.linear for frame in frames], frames[0].linear_before),
            )
        )
        best = replace(frames[-1], distance=distance)
        if distance <= _GOAL or best.degree + step > last:
            return best
        frames = [*frames[1:], frame_of(best.degree + step)]


def _frame_of(connection: Connection, patch: Patch, order: int) -> OptimalFrame:
    """Return the optimal frame of a degree, without its distance."""
    group = connection.group
    basis = Basis.of(patch.k, order)
    u, w = patch.nodes, np.sqrt(patch.weights / patch.weights.sum())
    A = pulled_back(connection, patch, u)
    n = group.linear
    values, slopes = basis.values(u), basis.slopes(u)
    turns, angular, steps = _best_turns(group, A[:, n:], values, slopes, w)
    shift = _best_shift(group, A, values, slopes, w)
    linear = (
        A[:, :n] + _across(group, A[:, n:], with_one(values) @ shift) - _slope_of(slopes, shift)
    )

    def size(field_: Array) -> float:
        return float(np.linalg.norm(w[:, None, None] * field_))

    return OptimalFrame(
        connection=connection,
        patch=patch,
        angular=size(angular),
        linear=size(linear),
        angular_before=size(A[:, n:]),
        linear_before=size(A[:, :n]),
        iterations=steps,
        degree=order,
        distance=np.inf,
        _basis=basis,
        _turns=turns,
        _shift=shift,
    )


def with_one(values: Array) -> Array:
    """Append the constant function 1 to basis values (N, K): (N, K + 1)."""
    return np.hstack([values, np.ones((len(values), 1))])


def _slope_of(slopes: Array, shift: Array) -> Array:
    """Return ∂p/∂u, (N, linear, k), for coefficients of p (K + 1, linear)."""
    return np.swapaxes(slopes @ shift[:-1], 1, 2)


def pulled_back(connection: Connection, patch: Patch, u: Array) -> Array:
    """Pull the connection back to the patch: A ∂x/∂u, (N, r, k), at parameters u (N, k)."""
    A, _, _ = connection.locals_at(patch.shapes(u))
    return np.asarray(A @ patch.slopes(u))


def _best_turns(
    group: Group, A: Array, values: Array, slopes: Array, w: Array
) -> tuple[tuple[Array, ...], Array, int]:
    """Compute the rotation R = Π exp φ that minimises ∫|A′_ω|².

    Args:
        group: Symmetry group.
        A: Rotational rows of the connection at the nodes, (N, turns, k).
        values: Basis functions at the nodes, (N, K).
        slopes: Derivatives of the basis functions, (N, k, K).
        w: Square roots of the normalised quadrature weights, (N,).
    Returns:
        The coefficients of each φ, A′_ω at the nodes, and the number of iterations.
    Raises:
        NoConvergence: The iteration does not converge.
    """
    if not group.turns:
        return (), A, 0
    # One factorisation of the least-squares problem ∂φ = A′ serves all iterations.
    count, k = slopes.shape[:2]
    weighted_slopes = (w[:, None, None] * slopes).reshape(count * k, -1)
    Q, upper = np.linalg.qr(weighted_slopes)
    turns: list[Array] = []
    current, before = A, np.inf
    for step in range(_ITERATIONS):
        size = float(np.linalg.norm(w[:, None, None] * current))
        if before - size <= _STILL * size or size < 1e-14:
            return tuple(turns), current, step
        right = (w[:, None, None] * np.swapaxes(current, 1, 2)).reshape(count * k, -1)
        turns.append(np.asarray(np.linalg.solve(upper, Q.T @ right)))
        before, current = size, _turned(group, A, tuple(turns), values, slopes)
    raise NoConvergence(
        "the attitude of the frame did not converge; make the patch smaller",
        float(_ITERATIONS),
        current,
    )


def _best_shift(group: Group, A: Array, values: Array, slopes: Array, w: Array) -> Array:
    """Compute the translation p that minimises ∫|A′_v|², by linear least squares.

    Args:
        group: Symmetry group.
        A: Connection at the nodes, (N, r, k).
        values: Basis functions at the nodes, (N, K).
        slopes: Derivatives of the basis functions, (N, k, K).
        w: Square roots of the normalised quadrature weights, (N,).
    Returns:
        Coefficients of p, (K + 1, linear), the constant last.
    """
    n, (count, k, K) = group.linear, slopes.shape
    if not n:
        return np.zeros((K + 1, 0))
    from scipy.linalg import lstsq

    # Solve ∂p_i − (A_ω × p)_i = (A_v)_i at every node and parameter. The constant of p matters
    # only if A_ω is not zero.
    basis, by = with_one(values), np.concatenate([slopes, np.zeros((count, k, 1))], axis=2)
    system = np.zeros((count, k, n, K + 1, n))
    units = np.eye(n)
    for j in range(n):
        system[:, :, j, :, j] += by
        crossed = _across(group, A[:, n:], np.tile(units[j], (count, 1)))  # (N, n, k)
        system[..., j] -= np.einsum("nia,nK->naiK", crossed, basis)
    system *= w[:, None, None, None, None]
    right = w[:, None, None] * np.swapaxes(A[:, :n], 1, 2)
    matrix = system.reshape(count * k * n, (K + 1) * n)
    # Use QR with pivoting, because the constant of p is undetermined if A_ω vanishes.
    solution = lstsq(matrix, right.ravel(), cond=1e-13, lapack_driver="gelsy", check_finite=False)[
        0
    ]
    return np.asarray(solution.reshape(K + 1, n))


def _across(group: Group, turning: Array, p: Array) -> Array:
    """Return A_ω × p, (N, linear, k), for A_ω (N, turns, k) and p (N, linear)."""
    n, k = group.linear, turning.shape[2]
    if not n or not group.turns:
        return np.zeros((len(p), n, k))
    twists = np.concatenate([np.zeros((len(p), n, k)), turning], axis=1)
    v = in_space(group, np.swapaxes(twists, 1, 2))[..., 3:]
    arms = in_space(group, np.concatenate([p, np.zeros((len(p), group.turns))], axis=1))[..., :3]
    crossed = np.cross(v, arms[:, None])[..., list(group.axes[:n])]
    return np.asarray(np.swapaxes(crossed, 1, 2))


def _attitude(group: Group, turns: Sequence[Array], values: Array) -> Array:
    """Return the attitude (N, 1) or (N, 4) of the product of rotations, for a basis (N, K)."""
    if not group.turns:
        return np.zeros((len(values), 0))
    if group.turns == 1:
        return np.asarray(sum((values @ c for c in turns), np.zeros((len(values), 1))))
    q = np.tile([0.0, 0.0, 0.0, 1.0], (len(values), 1))
    for c in turns:
        q = quaternion_product(q, quaternion_exp(values @ c))
    return q


def _rotation(group: Group, turns: Sequence[Array], values: Array) -> Array:
    """Return the rotation matrices, (N, linear, linear)."""
    attitude, n = _attitude(group, turns, values), group.linear
    units = np.eye(n)
    columns = [group.turned(attitude, np.tile(units[j], (len(values), 1))) for j in range(n)]
    return np.stack(columns, axis=2) if n else np.zeros((len(values), 0, 0))


def _turned(group: Group, A: Array, turns: Sequence[Array], values: Array, slopes: Array) -> Array:
    """Return A′_ω = Rᵀ (A_ω − (∂R Rᵀ)^∨) for R = Π exp φ, one factor after another."""
    for c in turns:
        d = np.swapaxes(slopes @ c, 1, 2)
        if group.turns == 1:
            A = A - d
            continue
        phi = values @ c
        R = rotation(quaternion_exp(phi))
        A = np.swapaxes(R, 1, 2) @ A - _right_slope(phi) @ d
    return A


def _right_slope(phi: Array) -> Array:
    """Return J, (N, 3, 3), with exp(−φ) ∂exp(φ) = J ∂φ on SO(3)."""
    angle = np.linalg.norm(phi, axis=1)[:, None, None]
    square = angle**2
    small = angle < 0.1
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 0.5 - square / 24.0 * (1.0 - square / 30.0), (1.0 - np.cos(safe)) / safe**2)
    series = 1.0 / 6.0 - square / 120.0 * (1.0 - square / 42.0)
    b = np.where(small, series, (safe - np.sin(safe)) / safe**3)
    H = hat(phi)
    return np.asarray(np.eye(3) - a * H + b * (H @ H))


_TRUSTED = 0.05  # relative error below which the integral is trusted


@checks_arguments
@dataclass(frozen=True, repr=False)
class CorrectedIntegral(Summary, FrozenArrays):
    """The corrected body-velocity integral −∬B of a gait, and the true phase.

    Attributes:
        integral: −∬B, a twist, (r,).
        phase: Phase of the gait in the same frame, (size,).
        log: Logarithm of the phase, (r,).
        error: |integral − log| / |log|, of the translations, or of the rotations if there are none.
        trusted: Whether the error is below five per cent.
    """

    integral: Array
    phase: Array
    log: Array
    error: float
    trusted: bool

    def title(self) -> str:
        """Return the first line of the text."""
        return "corrected integral −∬B of a gait, against its phase"

    def rows(self) -> Rows:
        """Return the rows of the text."""
        judgement = "trusted" if self.trusted else f"not trusted: above {_TRUSTED:g}"
        return [
            ("integral", _numbers(self.integral)),
            ("log of the phase", _numbers(self.log)),
            ("phase", _numbers(self.phase)),
            ("relative error", f"{self.error:.3g}, {judgement}"),
        ]


def _numbers(values: Array) -> str:
    return ", ".join(f"{value:.9g}" for value in values)


@checks_arguments
@Wait("integrates the curvature over a gait")
def corrected_integral(
    connection: ConnectionSource, gait: Gait, frame: OptimalFrame | None = None
) -> CorrectedIntegral:
    """Compute −∬B over the disc spanned by a Fourier gait, and the true phase.

    Args:
        connection: Connection that lifts the gait, or a System for its mechanical connection.
        gait: Gait that is one Fourier series.
        frame: Frame of the curvature, B′ = Ad_{h⁻¹}B; by default the base frame.
    Returns:
        Integral, phase and relative error.
    """
    connection = connection_of(connection, "corrected_integral").in_chart()
    group, disc = connection.group, Disc(gait)
    u = disc.nodes
    x = disc.shapes(u)
    slopes = disc.slopes(u)
    # Pull the curvature back to the two parameters of the disc.
    B = connection.grid(x).curvature
    density = np.einsum("niab,na,nb->ni", B, slopes[..., 0], slopes[..., 1])
    pose = phase(connection, gait).pose
    if frame is not None:
        is_disc = isinstance(frame.patch, Disc)
        frame_poses = frame.pose_at(u) if is_disc else frame.pose(x)
        density = (group.Ad(group.inverse(frame_poses)) @ density[..., None])[..., 0]
        h = frame.pose_at(np.array([[1.0, 0.0]]))[0] if is_disc else frame.pose(gait.at(0.0)[0])
        pose = group.compose(group.compose(group.inverse(h), pose), h)
    integral = -(disc.weights @ density)
    log = group.log(pose)
    components = slice(0, group.linear) if group.linear else slice(0, None)
    size = float(np.linalg.norm(log[components]))
    error = float(np.linalg.norm((integral - log)[components])) / size if size > 0.0 else np.inf
    return CorrectedIntegral(integral, pose, log, error, bool(error < _TRUSTED))


_RINGS, _SPOKES = 24, 64  # number of radial and of angular quadrature nodes of a disc


class Patch(ABC):
    """A map from parameters u in [−1, 1]^k, (N, k), to shapes (N, m)."""

    nodes: Array
    weights: Array

    @abstractmethod
    def shapes(self, u: Array) -> Array:
        """Return the shapes (N, m) at parameters u (N, k)."""

    @abstractmethod
    def slopes(self, u: Array) -> Array:
        """Return ∂x/∂u, (N, m, k), at parameters u (N, k)."""

    @abstractmethod
    def parameters(self, x: Array) -> Array:
        """Return the parameters (N, k) of shapes x (N, m) on the patch."""

    @property
    def k(self) -> int:
        """Number of parameters."""
        return int(self.nodes.shape[1])


@dataclass(frozen=True, eq=False)
class Box(Patch):
    """All values of some joints within limits, with the other joints fixed.

    Attributes:
        joints: Indices of the joints that vary, (k,).
        limits: Limits (low, high) of each varying joint, (k, 2) [rad | m].
        at: Shape that fixes the values of the other joints, (m,).
        count: Number of Gauss nodes per parameter.
        nodes: Quadrature nodes, (N, k).
        weights: Quadrature weights, (N,).
    """

    joints: tuple[int, ...]
    limits: Array
    at: Array
    count: int
    nodes: Array = field(init=False, repr=False)
    weights: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        k = len(self.joints)
        s, w = np.polynomial.legendre.leggauss(self.count)
        grids = np.meshgrid(*[s] * k, indexing="ij")
        object.__setattr__(self, "nodes", np.stack([grid.ravel() for grid in grids], axis=1))
        weights = np.ones(1)
        for _ in range(k):
            weights = np.multiply.outer(weights, w).ravel()
        object.__setattr__(self, "weights", weights)
        freeze(self)

    @property
    def _half(self) -> Array:
        return np.asarray(0.5 * (self.limits[:, 1] - self.limits[:, 0]))

    def shapes(self, u: Array) -> Array:
        """Return the shapes at parameters (see Patch.shapes)."""
        x = np.tile(self.at, (len(u), 1))
        x[:, list(self.joints)] = self.limits.mean(axis=1) + self._half * u
        return x

    def slopes(self, u: Array) -> Array:
        """Return the derivatives ∂x/∂u at parameters (see Patch.slopes)."""
        slopes = np.zeros((len(self.at), len(self.joints)))
        slopes[list(self.joints), np.arange(len(self.joints))] = self._half
        return np.broadcast_to(slopes, (len(u), *slopes.shape))

    def parameters(self, x: Array) -> Array:
        """Return the parameters of shapes (see Patch.parameters)."""
        return np.asarray((x[:, list(self.joints)] - self.limits.mean(axis=1)) / self._half)


@dataclass(frozen=True, eq=False)
class Disc(Patch):
    """The harmonic disc spanned by a Fourier gait: x = mean + Σ ρ^k (cos_k cos kφ + sin_k sin kφ).

    The parameters are u = (ρ cos φ, ρ sin φ), for any number of joints.

    Attributes:
        gait: Gait that is one Fourier series.
        nodes: Quadrature nodes, (N, 2).
        weights: Quadrature weights, (N,).
    """

    gait: Gait
    nodes: Array = field(init=False, repr=False)
    weights: Array = field(init=False, repr=False)
    _mean: Array = field(init=False, repr=False)
    _series: NDArray[np.complex128] = field(init=False, repr=False)  # x = mean + Re Σ series_k z^k

    def __post_init__(self) -> None:
        c = self.gait.series.coefficients()
        h = len(c) // 2
        object.__setattr__(self, "_mean", c[0])
        # On the edge of the disc, z = e^{iψ}, and ψ is the angle from the start of the gait.
        object.__setattr__(self, "_series", c[1 : 1 + h] - 1j * c[1 + h :])
        s, w = np.polynomial.legendre.leggauss(_RINGS)
        rho, angles = 0.5 * (s + 1.0), 2.0 * np.pi * np.arange(_SPOKES) / _SPOKES
        ring, spoke = (grid.ravel() for grid in np.meshgrid(rho, angles, indexing="ij"))
        points = np.stack([ring * np.cos(spoke), ring * np.sin(spoke)], axis=1)
        object.__setattr__(self, "nodes", points)
        weights = np.repeat(0.5 * w * rho, _SPOKES) * (2.0 * np.pi / _SPOKES)
        object.__setattr__(self, "weights", weights)
        freeze(self)

    def _powers(self, u: Array) -> Array:
        z = u[:, 0] + 1j * u[:, 1]
        return np.power.outer(z, np.arange(len(self._series) + 1))

    def shapes(self, u: Array) -> Array:
        """Return the shapes at parameters (see Patch.shapes)."""
        return np.asarray(self._mean + (self._powers(u)[:, 1:] @ self._series).real)

    def slopes(self, u: Array) -> Array:
        """Return the derivatives ∂x/∂u at parameters (see Patch.slopes)."""
        k = np.arange(1, len(self._series) + 1)[:, None]
        by_z = self._powers(u)[:, :-1] @ (k * self._series)
        return np.stack([by_z.real, -by_z.imag], axis=2)

    def parameters(self, x: Array) -> Array:
        """Return the parameters of shapes (see Patch.parameters), for a gait with one harmonic."""
        if len(self._series) > 1 and self._series[1:].any():
            raise InputError(
                "shapes: they determine parameters only on the disc of a gait with one harmonic"
            )
        plane = np.stack([self._series[0].real, -self._series[0].imag], axis=1)
        return np.asarray(np.linalg.lstsq(plane, (x - self._mean).T, rcond=None)[0].T)


def box_of(
    m: int, limits: ArrayLike, joints: Sequence[int] | None, at: ArrayLike | None, count: int
) -> Box:
    """Build a box of one to three joints.

    Args:
        m: Number of joints.
        limits: (low, high) of each joint that varies, (k, 2).
        joints: Indices of these joints; by default the first ones.
        at: Values of the other joints, (m,); zero by default.
        count: Number of Gauss nodes per parameter.
    Returns:
        The box.
    Raises:
        InputError: Limits or joints are invalid.
    """
    bounds = as_floats(limits, "limits")
    if bounds.ndim != 2 or bounds.shape[1:] != (2,) or not 1 <= len(bounds) <= 3:
        raise InputError(f"limits must be (low, high) of one to three joints, got {limits!r}")
    if not np.isfinite(bounds).all() or (bounds[:, 0] >= bounds[:, 1]).any():
        raise InputError(f"limits must be finite and increase, got {limits!r}")
    chosen = tuple(range(len(bounds)) if joints is None else joints)
    if len(chosen) != len(bounds) or not set(chosen) <= set(range(m)):
        raise InputError(f"joints must be {len(bounds)} indices below {m}, got {chosen}")
    fixed = np.zeros(m) if at is None else vector(at, m, "at")
    return Box(chosen, bounds.copy(), fixed.copy(), count)


@dataclass(frozen=True, eq=False)
class Basis:
    """Products of Chebyshev polynomials up to a total degree, without the constant.

    Attributes:
        powers: Degree per parameter of each product, K tuples.
    """

    powers: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, k: int, degree: int) -> Basis:
        """Return the basis in k parameters of total degree at most `degree`."""
        exponents = product(range(degree + 1), repeat=k)
        return cls(tuple(powers for powers in exponents if 0 < sum(powers) <= degree))

    def values(self, u: Array) -> Array:
        """Return the polynomials at parameters u (N, k), (N, K)."""
        tables, _ = self._tables(u)
        return self._products(tables)

    def slopes(self, u: Array) -> Array:
        """Return the derivatives of the polynomials at parameters u (N, k), (N, k, K)."""
        tables, slopes = self._tables(u)
        derivatives = []
        for axis in range(u.shape[1]):
            factors = [*tables]
            factors[axis] = slopes[axis]
            derivatives.append(self._products(factors))
        return np.stack(derivatives, axis=1)

    def _tables(self, u: Array) -> tuple[list[Array], list[Array]]:
        degree = max(max(powers) for powers in self.powers)
        values = [chebyshev.chebvander(column, degree) for column in u.T]
        step = np.zeros((degree + 1, degree + 1))
        for k in range(1, degree + 1):
            series = chebyshev.chebder(np.eye(degree + 1)[k])
            step[: len(series), k] = series
        return values, [table @ step for table in values]

    def _products(self, tables: Sequence[Array]) -> Array:
        products = np.ones((len(tables[0]), len(self.powers)))
        for axis, table in enumerate(tables):
            products *= table[:, [powers[axis] for powers in self.powers]]
        return products
