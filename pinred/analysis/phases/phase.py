"""The phase of a gait: the group element by which one cycle moves the base."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ...common.arrays import Array, freeze, positive, vector, whole
from ...common.errors import InputError, IntegrationError, NoConvergence
from ...lie.group import Group, PoseError
from ..connections.connection import Connection
from ..gaits.gait import Gait
from .lift import PathSegments, lift, travelled
from .sampling import refined
from .screw import Screw, screw_of

_FLOOR = 64.0 * np.finfo(float).eps  # round-off, relative to the path length of the base
_LEAST = 1e-14  # smallest tolerance


@dataclass(frozen=True, eq=False)
class Phase:
    """The motion of the base over one cycle of a gait.

    Attributes:
        group: Symmetry group.
        pose: Group element g of the cycle, (size,); the base starts at the identity.
        error: Error estimate, the difference to half as many samples: rotation [rad] and
            translation [m].
        geometric: Horizontal lift, (size,), which is g at zero momentum.
        momentum: Body momentum at the start of the cycle, (r,).
        times: Times of the path, (P + 1,) [s].
        path: Poses during the cycle, (P + 1, size).
        length: ∫√(ẋᵀMẋ) dt of the gait; NaN if the connection has no metric.
        samples: Number of shapes at which the connection was evaluated.
    """

    group: Group
    pose: Array
    error: PoseError
    geometric: Array
    momentum: Array
    times: Array
    path: Array
    length: float
    samples: int
    _segments: PathSegments = field(repr=False)

    def __post_init__(self) -> None:
        freeze(self)

    @cached_property
    def dynamic(self) -> Array:
        """Dynamic factor of the pose, (size,), with g = dynamic · geometric.

        The identity at zero momentum.
        """
        return self.group.compose(self.pose, self.group.inverse(self.geometric))

    @property
    def end_momentum(self) -> Array:
        """Body momentum at the end of the cycle, (r,): Ad_gᵀ applied to the initial one."""
        return np.asarray(self.group.Ad(self.pose).T @ self.momentum)

    @property
    def log(self) -> Array:
        """Logarithm of the pose, (r,): the constant body twist that reaches it in unit time."""
        return self.group.log(self.pose)

    @property
    def screw(self) -> Screw:
        """Steady drift or orbit of the base over many cycles, as a screw."""
        return screw_of(self.group, self.pose)

    def cycles(self, n: int) -> Array:
        """Return the pose after n cycles.

        With momentum, cycles are computed one after another, because μ rotates with the body.

        Args:
            n: Number of cycles. It may be negative at zero momentum.
        Returns:
            (size,).
        Raises:
            InputError: n is negative and there is momentum.
        """
        n, group = whole(n, "cycles", -(2**31)), self.group
        if not self.momentum.any():
            step = self.pose if n >= 0 else group.inverse(self.pose)
            return _power(group, step, abs(n))
        if n < 0:
            raise InputError(f"cycles: with momentum, expected a non-negative number, got {n}")
        pose = group.identity()
        for _ in range(n):
            mu = group.Ad(pose).T @ self.momentum
            pose = group.normalize(group.compose(pose, lift(group, self._segments, mu)[-1]))
        return pose


def phase(
    connection: Connection,
    gait: Gait,
    momentum: ArrayLike | float = 0,
    *,
    tolerance: float = 1e-10,
) -> Phase:
    """Compute the phase of a gait: the pose g after one cycle of g⁻¹ġ = −A ẋ + P_b⁻¹ μ.

    The number of samples is doubled until the pose changes by less than the tolerance. On a
    Fourier series, convergence is spectral.

    Args:
        connection: Connection that lifts the gait.
        gait: Closed path in shape space.
        momentum: 0, or the body momentum μ at the start, (r,). Ad*_{g⁻¹} μ is conserved.
        tolerance: Tolerance of the pose, in rotation [rad] and translation [m].
    Returns:
        The phase with its error estimate.
    Raises:
        SymmetryError: Gravity rotates the base, so momentum is not conserved.
        SingularInertiaError: The gait meets a singular shape.
        IntegrationError: The tolerance is out of reach.
        InputError: An argument is of the wrong kind, or gait and connection do not match.
    """
    if not isinstance(connection, Connection) or not isinstance(gait, Gait):
        raise InputError(
            f"phase takes a Connection and a Gait, got {type(connection).__name__} and "
            f"{type(gait).__name__}"
        )
    connection.refuse_gravity()
    goal = max(positive(tolerance, "tolerance"), _LEAST)
    mu = _momentum(connection, momentum)
    group, has_momentum = connection.group, bool(mu.any())
    previous: Array | None = None
    error = np.inf
    for sampled in refined(connection, gait, momentum=has_momentum):
        try:
            path = lift(group, sampled.segments, mu)
        except NoConvergence:
            previous = None
            continue
        pose = path[-1].copy()
        if previous is not None:
            difference = group.error(previous, pose)
            error = float(np.maximum(difference.rotation, difference.translation))
            if error <= goal:
                return Phase(
                    group=group,
                    pose=pose,
                    error=_bound(difference, sampled.segments, pose),
                    geometric=_horizontal(group, sampled.segments, pose, has_momentum=has_momentum),
                    momentum=mu,
                    times=np.concatenate([[0.0], np.cumsum(sampled.segments.h)]),
                    path=path,
                    length=sampled.length,
                    samples=sampled.samples,
                    _segments=sampled.segments,
                )
        previous = pose
    raise IntegrationError(
        f"the phase did not reach the tolerance {goal:g}: the last doubling changed it by "
        f"{error:.2g}; the gait passes near a singular shape, or the tolerance is below round-off"
    )


def _bound(difference: PoseError, segments: PathSegments, pose: Array) -> PoseError:
    """Return the change by the last doubling, plus round-off."""
    rotation, translation = travelled(segments)
    return PoseError(
        rotation=difference.rotation + _FLOOR * (1.0 + rotation),
        translation=difference.translation + _FLOOR * (translation + rotation * np.abs(pose).max()),
    )


def _momentum(connection: Connection, momentum: ArrayLike | float) -> Array:
    if np.ndim(momentum) == 0 and momentum == 0:
        return np.zeros(connection.r)
    mu = vector(np.asarray(momentum), connection.r, "momentum", connection.group.twist_names)
    if mu.any() and not connection.form.momentum:
        raise InputError(f"{connection.form.what} carry no momentum; leave momentum out")
    return mu


def _horizontal(group: Group, segments: PathSegments, pose: Array, *, has_momentum: bool) -> Array:
    if not has_momentum:
        return pose.copy()
    horizontal = replace(segments, L=np.zeros((0, *segments.L.shape[1:])))
    return np.asarray(lift(group, horizontal, np.zeros(group.dim))[-1])


def _power(group: Group, g: Array, n: int) -> Array:
    power = group.identity()
    while n:
        if n & 1:
            power = group.normalize(group.compose(power, g))
        g, n = group.normalize(group.compose(g, g)), n >> 1
    return power
