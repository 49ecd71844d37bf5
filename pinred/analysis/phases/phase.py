"""Phase: the element of the group by which one cycle of a gait moves the body."""

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
from .lift import Pieces, lift, travelled
from .sampling import refined
from .screw import Screw, screw_of

_FLOOR = 64.0 * np.finfo(float).eps  # of how far the body travels: round-off
_LEAST = 1e-14


@dataclass(frozen=True, eq=False)
class Phase:
    """What one cycle of a gait does to the body, from the identity.

    pose: (size,) the group element g of the cycle.  error: a bound of its error, the difference
    to half as many samples: rotation [rad], translation [m].  geometric: (size,) the horizontal
    lift, what is left of g without momentum.  dynamic: (size,) with g = dynamic · geometric; the
    identity without momentum.  momentum: (r,) body momentum at the start of the cycle.  times,
    path: (P + 1,) [s] and (P + 1, size), poses on the way.  length: ∫√(ẋᵀMẋ) dt of the gait, NaN
    where the connection has no metric.  samples: at how many shapes the connection was evaluated.
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
    _pieces: Pieces = field(repr=False)

    def __post_init__(self) -> None:
        freeze(self)

    @cached_property
    def dynamic(self) -> Array:
        """Part of the pose that momentum makes: g = dynamic · geometric."""
        return self.group.compose(self.pose, self.group.inverse(self.geometric))

    @property
    def end_momentum(self) -> Array:
        """Body momentum at the end of the cycle, (r,): Ad_gᵀ of that at the start."""
        return np.asarray(self.group.Ad(self.pose).T @ self.momentum)

    @property
    def log(self) -> Array:
        """Logarithm of the pose, (r,): the steady twist that makes it in unit time."""
        return self.group.log(self.pose)

    @property
    def screw(self) -> Screw:
        """Steady drift or orbit of the body, cycle after cycle, as a screw."""
        return screw_of(self.group, self.pose)

    def cycles(self, n: int) -> Array:
        """Return the pose after n cycles, (size,); n may be negative without momentum.

        Without momentum a power of the pose; with it, cycle by cycle, as μ turns with the body.
        """
        n, group = whole(n, "cycles", -(2**31)), self.group
        if not self.momentum.any():
            step = self.pose if n >= 0 else group.inverse(self.pose)
            return _power(group, step, abs(n))
        if n < 0:
            raise InputError(f"with momentum, cycles takes a number that is not negative, got {n}")
        out = group.identity()
        for _ in range(n):
            mu = group.Ad(out).T @ self.momentum
            out = group.normalize(group.compose(out, lift(group, self._pieces, mu)[-1]))
        return out


def phase(
    connection: Connection,
    gait: Gait,
    momentum: ArrayLike | float = 0,
    *,
    tolerance: float = 1e-10,
) -> Phase:
    """Return what one cycle of a gait does to the body: g with g⁻¹ġ = −A ẋ + P_b⁻¹ μ.

    momentum: 0, or the body momentum μ at the start, (r,), of which Ad*_{g⁻¹} μ is conserved.
    tolerance: on the error of the pose, rotation [rad] and translation [m] alike; the samples
    are doubled until the difference that makes is below it.  Exact derivatives are not needed:
    where the gait is a Fourier series, convergence is spectral.
    Raises SymmetryError where gravity turns the base, so that momenta are not conserved,
    SingularInertiaError where the gait meets a singular shape, IntegrationError if the
    tolerance is out of reach, InputError if gait and connection do not belong together.
    """
    if not isinstance(connection, Connection) or not isinstance(gait, Gait):
        raise InputError(
            f"phase takes a Connection and a Gait, got {type(connection).__name__} and "
            f"{type(gait).__name__}"
        )
    connection.refuse_gravity()
    wanted = max(positive(tolerance, "tolerance"), _LEAST)
    mu = _momentum(connection, momentum)
    group, moving = connection.group, bool(mu.any())
    last: Array | None = None
    error = np.inf
    for sampled in refined(connection, gait, momentum=moving):
        try:
            path = lift(group, sampled.pieces, mu)
        except NoConvergence:
            last = None
            continue
        pose = path[-1].copy()
        if last is not None:
            apart = group.error(last, pose)
            error = float(np.maximum(apart.rotation, apart.translation))
            if error <= wanted:
                return Phase(
                    group=group,
                    pose=pose,
                    error=_bound(apart, sampled.pieces, pose),
                    geometric=_horizontal(group, sampled.pieces, pose, moving=moving),
                    momentum=mu,
                    times=np.concatenate([[0.0], np.cumsum(sampled.pieces.h)]),
                    path=path,
                    length=sampled.length,
                    samples=sampled.samples,
                    _pieces=sampled.pieces,
                )
        last = pose
    raise IntegrationError(
        f"the phase did not reach the tolerance {wanted:g}: the last doubling changed it by "
        f"{error:.2g}; the gait passes near a singular shape, or the tolerance is below round-off"
    )


def _bound(apart: PoseError, pieces: Pieces, pose: Array) -> PoseError:
    """Return the difference that the last doubling made, and round-off."""
    turned, moved = travelled(pieces)
    return PoseError(
        rotation=apart.rotation + _FLOOR * (1.0 + turned),
        translation=apart.translation + _FLOOR * (moved + turned * np.abs(pose).max()),
    )


def _momentum(connection: Connection, momentum: ArrayLike | float) -> Array:
    if np.ndim(momentum) == 0 and momentum == 0:
        return np.zeros(connection.r)
    mu = vector(np.asarray(momentum), connection.r, "momentum", connection.group.twist_names)
    if mu.any() and not connection.form.momentum:
        raise InputError(f"{connection.form.what} carry no momentum; leave momentum out")
    return mu


def _horizontal(group: Group, pieces: Pieces, pose: Array, *, moving: bool) -> Array:
    if not moving:
        return pose.copy()
    without = replace(pieces, L=np.zeros((0, *pieces.L.shape[1:])))
    return np.asarray(lift(group, without, np.zeros(group.dim))[-1])


def _power(group: Group, g: Array, n: int) -> Array:
    out = group.identity()
    while n:
        if n & 1:
            out = group.normalize(group.compose(out, g))
        g, n = group.normalize(group.compose(g, g)), n >> 1
    return out
