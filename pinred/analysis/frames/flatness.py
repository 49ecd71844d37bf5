"""Whether a connection is flat: then shapes alone decide where a frame is, and no loop moves it.

A frame on the body whose twist is a given velocity, the average angular velocity say, exists
where the curvature of the connection vanishes, and only there: horizontal motions are then those of
coordinates (the distribution is integrable, by Frobenius).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from ...common.arrays import Array, as_floats, freeze, vector
from ...common.errors import InputError
from ..connections.connection import Connection
from ..gaits.arcs import line
from ..phases.lift import STAGES, Pieces, in_space, lift, nodes

_FLAT = 1e-10  # of the terms of which the curvature is a sum
_SAMPLES = {1: 101, 2: 31, 3: 13}
_RANDOM = 2000  # shapes, of more joints
_PIECES = 32


@dataclass(frozen=True)
class Flatness:
    """The verdict on a box of shapes, with its numbers.

    curvature: largest |B_αβ| of rotations [rad/…] and of all rows.  relative: the same over the
    terms that it is a sum of.  attitude_is_flat: whether the average angular velocity is that of a
    frame.  is_flat: whether all of A is.  worst: (m,) the shape where |B| is largest.
    """

    curvature: tuple[float, float]
    relative: tuple[float, float]
    attitude_is_flat: bool
    is_flat: bool
    worst: Array
    connection: Connection = field(repr=False)
    reference: Array = field(repr=False)

    def __post_init__(self) -> None:
        freeze(self)

    def __str__(self) -> str:
        def row(what: str, k: int, *, flat: bool) -> str:
            words = "flat" if flat else "not flat"
            return (
                f"{what}: {words}; |B| {self.curvature[k]:.3g}, of its terms {self.relative[k]:.2g}"
            )

        return "\n".join(
            [
                row("attitude", 0, flat=self.attitude_is_flat),
                row("whole frame", 1, flat=self.is_flat),
                f"largest at x = {np.array2string(self.worst, precision=4)}",
            ]
        )

    def coordinates(self, x: ArrayLike) -> Array:
        """h(x), the pose (size,) of the frame that no change of shape moves, h = 1 at the middle.

        Where only the attitude is flat, so is that of h.  Raises InputError where neither is.
        """
        if not (self.is_flat or self.attitude_is_flat):
            raise InputError(
                f"there is no such frame: the curvature is {self.relative[0]:.2g} of its terms"
            )
        connection = self.connection
        to = vector(x, connection.m, "x", connection.joints)
        path = line(self.reference, to, 1.0)
        s = ((np.arange(_PIECES)[:, None] + nodes()) / _PIECES).ravel()
        xi, _ = connection.horizontal(*path.at(s))
        pieces = Pieces(
            h=np.full(_PIECES, 1.0 / _PIECES),
            a=in_space(connection.group, xi).reshape(_PIECES, STAGES, 6),
            L=np.zeros((0, STAGES, 6, 6)),
        )
        g = lift(connection.group, pieces, np.zeros(connection.r))[-1]
        return connection.group.inverse(g)


def flatness(
    connection: Connection, limits: ArrayLike | None = None, *, samples: int | None = None
) -> Flatness:
    """Return whether a connection is flat over a box of shapes.

    limits: (low, high) of each joint, (m, 2); ±1 if not given.  samples: along each joint, of up to
    three; at random shapes of more.
    Raises SingularInertiaError where A is not defined.
    """
    m, n = connection.m, connection.group.linear
    bounds = np.tile([-1.0, 1.0], (m, 1)) if limits is None else as_floats(limits, "limits")
    if bounds.shape != (m, 2) or not np.isfinite(bounds).all() or (np.diff(bounds) <= 0.0).any():
        raise InputError(f"limits must be (low, high) of each of {m} joints, got {limits!r}")
    if 1 <= m <= 3:
        count = samples or _SAMPLES[m]
        axes = [np.linspace(low, high, count) for low, high in bounds]
        x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, m)
    else:
        rng = np.random.default_rng(0)
        x = rng.uniform(bounds[:, 0], bounds[:, 1], (samples or _RANDOM, m))
    found = connection.grid(x)
    B, exterior, bracket = found.curvature, found.exterior, found.bracket
    terms = np.abs(exterior) + np.abs(bracket)
    if m:  # what ∂_αA_β and its counterpart are, which may cancel, too
        terms = terms + np.abs(found.local).max(axis=(1, 2), keepdims=True)[..., None] ** 2

    def largest(rows: slice) -> tuple[float, float]:
        size = float(np.abs(B[:, rows]).max(initial=0.0))
        whole = float(terms[:, rows].max(initial=0.0))
        return size, size / whole if whole > 0.0 else 0.0

    turning, every = largest(slice(n, None)), largest(slice(None))
    sizes = np.abs(B).max(axis=(1, 2, 3)) if B.size else np.zeros(len(x))
    return Flatness(
        curvature=(turning[0], every[0]),
        relative=(turning[1], every[1]),
        attitude_is_flat=turning[1] <= _FLAT,
        is_flat=every[1] <= _FLAT,
        worst=x[int(np.argmax(sizes))].copy(),
        connection=connection,
        reference=bounds.mean(axis=1),
    )
