"""Minimum-perturbation coordinates: the frame on the body in which gaits disturb it least.

In a frame h(x) the connection is A′ = Ad_{h⁻¹}A − h⁻¹∂h.  With h = (R, p),

    A′_ω = Rᵀ (A_ω − (∂R Rᵀ)^∨),   A′_v = Rᵀ (A_v + A_ω × p − ∂p),

so that the best R does not depend on p, and the best p not on R.  Both make ∫|A′|² over a patch
least among polynomials of its parameters: R by Poisson's equation (once for a plane, again and
again with R ← R exp φ in space), p by linear least squares.  Source: R. Hatton, H. Choset,
"Geometric motion planning: the local connection, Stokes' theorem, and the importance of coordinate
choice", Int. J. Robotics Research 30 (2011); in space, Faraji et al., for SO(3), as a gauge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from ...common.arrays import Array, read_only, vectors
from ...common.errors import InputError, NoConvergence
from ...lie.group import Group
from ...lie.rotations import hat, quaternion_exp, quaternion_product, rotation
from ..connections.connection import Connection
from ..gaits.gait import Gait
from ..phases.lift import in_space
from .patches import Basis, Disc, Patch, box_of

_DEGREES = {1: 20, 2: 14, 3: 6}
_MORE_NODES = 6  # than the degree of the polynomials, along each parameter
_ITERATIONS = 60
_STILL = 1e-10  # relative change of ∫|A′_ω|² by an iteration


@dataclass(frozen=True, eq=False)
class OptimalFrame:
    """A frame h(x) on the body, over a patch of shape space, that makes ∫|A′|² least.

    angular, linear: root mean squares of A′ over the patch, of its rotations [rad per parameter]
    and translations [m], parameters running over ±1.  angular_before, linear_before: of A.
    iterations: of the attitude.
    """

    connection: Connection
    patch: Patch = field(repr=False)
    angular: float
    linear: float
    angular_before: float
    linear_before: float
    iterations: int
    _basis: Basis = field(repr=False)
    _turns: tuple[Array, ...] = field(repr=False)
    _shift: Array = field(repr=False)

    def pose(self, shapes: ArrayLike) -> Array:
        """h(x), the pose (..., size) of the frame as the base sees it, at shapes (..., m)."""
        connection = self.connection
        x = vectors(shapes, connection.m, "shapes", connection.joints)
        u = self.patch.parameters(x.reshape(-1, connection.m))
        return read_only(self.pose_at(u).reshape(*x.shape[:-1], connection.group.size))

    def pose_at(self, u: Array) -> Array:
        """h, (N, size), at parameters (N, k) of the patch."""
        group = self.connection.group
        values = self._basis.values(u)
        linear = with_one(values) @ self._shift
        return np.concatenate([linear, _attitude(group, self._turns, values)], axis=1)

    def local(self, shapes: ArrayLike) -> Array:
        """A′ of the patch's parameters, (..., r, k), at shapes (..., m)."""
        connection = self.connection
        x = vectors(shapes, connection.m, "shapes", connection.joints)
        u = self.patch.parameters(x.reshape(-1, connection.m))
        return read_only(self.local_at(u).reshape(*x.shape[:-1], connection.r, self.patch.k))

    def local_at(self, u: Array) -> Array:
        """A′ of the patch's parameters, (N, r, k), at parameters (N, k)."""
        group = self.connection.group
        A = pulled_back(self.connection, self.patch, u)
        values, slopes = self._basis.values(u), self._basis.slopes(u)
        p, dp = with_one(values) @ self._shift, _slope_of(slopes, self._shift)
        n = group.linear
        turned = _turned(group, A[:, n:], self._turns, values, slopes)
        moved = A[:, :n] + _across(group, A[:, n:], p) - dp
        R = _rotation(group, self._turns, values)
        return np.concatenate([np.swapaxes(R, 1, 2) @ moved if n else moved, turned], axis=1)


def optimal_frame(
    connection: Connection,
    limits: ArrayLike | Gait,
    *,
    joints: Sequence[int] | None = None,
    at: ArrayLike | None = None,
    degree: int | None = None,
    nodes: int | None = None,
) -> OptimalFrame:
    """Return the minimum-perturbation frame over a box of one to three joints, or a gait's disc.

    limits: (low, high) of each joint, (k, 2); or a Fourier gait, for any number of joints.
    joints: indices of those that vary, the first if not given.  at: (m,) where the others stand.
    degree: of the polynomials.  nodes: along each parameter, of the grid of a box.
    Raises SingularInertiaError where A is not defined on the patch, NoConvergence if the attitude
    does not settle.
    """
    group = connection.group
    patch: Patch
    if isinstance(limits, Gait):
        if joints is not None or at is not None or nodes is not None:
            raise InputError("joints, at and nodes go with limits of joints, not with a gait")
        patch, order = Disc(limits), _DEGREES[2] if degree is None else int(degree)
    else:
        order = _DEGREES[min(len(np.atleast_1d(limits)), 3)] if degree is None else int(degree)
        patch = box_of(connection.m, limits, joints, at, nodes or order + _MORE_NODES)
    basis = Basis.of(patch.k, order)
    u, w = patch.nodes, np.sqrt(patch.weights / patch.weights.sum())
    A = pulled_back(connection, patch, u)
    n = group.linear
    values, slopes = basis.values(u), basis.slopes(u)
    turns, angular, steps = _best_turns(group, A[:, n:], values, slopes, w)
    shift = _best_shift(group, A, values, slopes, w)
    moved = A[:, :n] + _across(group, A[:, n:], with_one(values) @ shift) - _slope_of(slopes, shift)

    def size(field_: Array) -> float:
        return float(np.linalg.norm(w[:, None, None] * field_))

    return OptimalFrame(
        connection=connection,
        patch=patch,
        angular=size(angular),
        linear=size(moved),
        angular_before=size(A[:, n:]),
        linear_before=size(A[:, :n]),
        iterations=steps,
        _basis=basis,
        _turns=turns,
        _shift=shift,
    )


def with_one(values: Array) -> Array:
    """Return the basis with the constant at its end, (N, K + 1)."""
    return np.hstack([values, np.ones((len(values), 1))])


def _slope_of(slopes: Array, shift: Array) -> Array:
    """Return ∂p, (N, linear, k), of coefficients (K + 1, linear)."""
    return np.swapaxes(slopes @ shift[:-1], 1, 2)


def pulled_back(connection: Connection, patch: Patch, u: Array) -> Array:
    """Return A ∂x/∂u, (N, r, k), at parameters (N, k)."""
    A, _, _ = connection.locals_at(patch.shapes(u))
    return np.asarray(A @ patch.slopes(u))


def _best_turns(
    group: Group, A: Array, values: Array, slopes: Array, w: Array
) -> tuple[tuple[Array, ...], Array, int]:
    """Return coefficients of φ with R = Π exp φ, then A′_ω, and the number of iterations."""
    if not group.turns:
        return (), A, 0
    # One factorisation of ∂φ = A′ in the mean square serves all entries and iterations.
    count, k = slopes.shape[:2]
    rows = (w[:, None, None] * slopes).reshape(count * k, -1)
    Q, upper = np.linalg.qr(rows)
    turns: list[Array] = []
    now, before = A, np.inf
    for step in range(_ITERATIONS):
        size = float(np.linalg.norm(w[:, None, None] * now))
        if before - size <= _STILL * size or size < 1e-14:
            return tuple(turns), now, step
        right = (w[:, None, None] * np.swapaxes(now, 1, 2)).reshape(count * k, -1)
        turns.append(np.asarray(np.linalg.solve(upper, Q.T @ right)))
        before, now = size, _turned(group, A, tuple(turns), values, slopes)
    raise NoConvergence(
        "the attitude of the frame did not settle; make the patch smaller", float(_ITERATIONS), now
    )


def _best_shift(group: Group, A: Array, values: Array, slopes: Array, w: Array) -> Array:
    """Return coefficients (K + 1, linear) of p, the constant last, by linear least squares."""
    n, (count, k, K) = group.linear, slopes.shape
    if not n:
        return np.zeros((K + 1, 0))
    from scipy.linalg import lstsq

    # ∂p_i − (A_ω × p)_i = (A_v)_i, for every node and parameter; p is a sum over the basis,
    # and a constant, which only matters where something turns.
    whole, by = with_one(values), np.concatenate([slopes, np.zeros((count, k, 1))], axis=2)
    system = np.zeros((count, k, n, K + 1, n))
    units = np.eye(n)
    for j in range(n):
        system[:, :, j, :, j] += by
        turned = _across(group, A[:, n:], np.tile(units[j], (count, 1)))  # (N, n, k)
        system[..., j] -= np.einsum("nia,nK->naiK", turned, whole)
    system *= w[:, None, None, None, None]
    right = w[:, None, None] * np.swapaxes(A[:, :n], 1, 2)
    rows = system.reshape(count * k * n, (K + 1) * n)
    # By QR with pivots: where nothing turns, the constant has no say.
    found = lstsq(rows, right.ravel(), cond=1e-13, lapack_driver="gelsy", check_finite=False)[0]
    return np.asarray(found.reshape(K + 1, n))


def _across(group: Group, turning: Array, p: Array) -> Array:
    """Return A_ω × p, (N, linear, k), of A_ω (N, turns, k) and p (N, linear)."""
    n, k = group.linear, turning.shape[2]
    if not n or not group.turns:
        return np.zeros((len(p), n, k))
    twists = np.concatenate([np.zeros((len(p), n, k)), turning], axis=1)
    v = in_space(group, np.swapaxes(twists, 1, 2))[..., 3:]
    arms = in_space(group, np.concatenate([p, np.zeros((len(p), group.turns))], axis=1))[..., :3]
    crossed = np.cross(v, arms[:, None])[..., list(group.axes[:n])]
    return np.asarray(np.swapaxes(crossed, 1, 2))


def _attitude(group: Group, turns: Sequence[Array], values: Array) -> Array:
    """Return the attitude (N, 1) or (N, 4) that the turns make, of (N, K)."""
    if not group.turns:
        return np.zeros((len(values), 0))
    if group.turns == 1:
        return np.asarray(sum((values @ c for c in turns), np.zeros((len(values), 1))))
    q = np.tile([0.0, 0.0, 0.0, 1.0], (len(values), 1))
    for c in turns:
        q = quaternion_product(q, quaternion_exp(values @ c))
    return q


def _rotation(group: Group, turns: Sequence[Array], values: Array) -> Array:
    """Return Rotations of translations, (N, linear, linear)."""
    attitude, n = _attitude(group, turns, values), group.linear
    units = np.eye(n)
    columns = [group.turned(attitude, np.tile(units[j], (len(values), 1))) for j in range(n)]
    return np.stack(columns, axis=2) if n else np.zeros((len(values), 0, 0))


def _turned(group: Group, A: Array, turns: Sequence[Array], values: Array, slopes: Array) -> Array:
    """Return A′_ω = Rᵀ (A_ω − (∂R Rᵀ)^∨) for R = Π exp φ, each turn in its order."""
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
    """Return J with exp(−φ) ∂exp(φ) = J ∂φ on SO(3), (N, 3, 3)."""
    angle = np.linalg.norm(phi, axis=1)[:, None, None]
    square = angle**2
    small = angle < 0.1
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 0.5 - square / 24.0 * (1.0 - square / 30.0), (1.0 - np.cos(safe)) / safe**2)
    series = 1.0 / 6.0 - square / 120.0 * (1.0 - square / 42.0)
    b = np.where(small, series, (safe - np.sin(safe)) / safe**3)
    H = hat(phi)
    return np.asarray(np.eye(3) - a * H + b * (H @ H))
