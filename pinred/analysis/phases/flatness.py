"""Flatness of a connection: whether the base pose is a function of the shape.

A frame on the body whose twist equals a chosen velocity, such as the average angular velocity,
exists exactly where the curvature of the connection vanishes. The horizontal distribution is then
integrable (Frobenius).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, FrozenArrays, as_floats, vector, whole
from ...common.errors import InputError
from ...common.waiting import Wait
from ..connections.connection import Connection, ConnectionSource, connection_of
from .gait import Gait, line
from .lift import STAGES, PathSegments, in_space, lift, nodes
from .phase import is_closed, phase

_FLAT = 1e-10  # largest curvature of a flat connection, relative to its terms
_MOST_SHAPES = 10**6
_SAMPLES = {1: 101, 2: 31, 3: 13}  # number of grid points per joint, for 1, 2 or 3 joints
_RANDOM = 2000  # number of random shapes, for more than three joints
_SEGMENTS = 32  # number of segments of a lifted path


@checks_arguments
@dataclass(frozen=True)
class Flatness(FrozenArrays):
    """Flatness of a connection over a box of shapes.

    Attributes:
        curvature: Largest |B_αβ| of the rotations [rad/…], and of all components.
        relative: The same maxima, relative to the terms of the curvature.
        attitude_is_flat: Whether the attitude of some frame is a function of the shape.
        is_flat: Whether the pose of some frame is a function of the shape.
        worst: Shape with the largest |B|, (m,).
        connection: The connection.
        reference: Middle of the box, (m,).

    A flat connection has a frame that is a function of the shape on a box. On the circle of a
    revolute joint, that function is unique only up to the holonomy.
    """

    curvature: tuple[float, float]
    relative: tuple[float, float]
    attitude_is_flat: bool
    is_flat: bool
    worst: Array
    connection: Connection = field(repr=False)
    reference: Array = field(repr=False)

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
                *(
                    f"a turn of {joint} moves the base by {np.array2string(pose, precision=6)}"
                    for joint, pose in self.holonomy.items()
                ),
            ]
        )

    @cached_property
    def holonomy(self) -> dict[str, Array]:
        """Poses by which a complete turn of each revolute joint moves the base, {joint: (size,)}.

        The turns are at the middle of the box. Empty if the attitude is not flat; if only the
        attitude is flat, only the attitudes are meaningful. A connection with a holonomy other than
        the identity is no product of base and shape on the whole circle, although it is flat.
        """
        connection = self.connection
        if not self.attitude_is_flat:
            return {}
        poses = {}
        for k, joint in enumerate(connection.joints):
            gait = Gait.waypoints(
                [self.reference], turns=np.eye(connection.m, dtype=int)[k].tolist()
            )
            if is_closed(connection, gait):
                poses[joint] = phase(connection, gait).pose
        return poses

    def coordinates(self, x: ArrayLike) -> Array:
        """Return the pose h(x) of the frame that does not move; it is 1 in the middle of the box.

        If only the attitude is flat, only the attitude of h is meaningful.

        Args:
            x: Shape, (m,).
        Returns:
            Pose coordinates of h, (size,).
        Raises:
            InputError: Neither attitude nor pose is flat.
        """
        if not (self.is_flat or self.attitude_is_flat):
            raise InputError(
                "the connection is not flat, so no such frame exists: "
                f"the curvature is {self.relative[0]:.2g} of its terms"
            )
        connection = self.connection
        to = vector(x, connection.m, "x", connection.joints)
        path = line(self.reference, to, 1.0)
        s = ((np.arange(_SEGMENTS)[:, None] + nodes()) / _SEGMENTS).ravel()
        xi, _ = connection.horizontal(*path.at(s))
        segments = PathSegments(
            h=np.full(_SEGMENTS, 1.0 / _SEGMENTS),
            a=in_space(connection.group, xi).reshape(_SEGMENTS, STAGES, 6),
            L=np.zeros((0, STAGES, 6, 6)),
        )
        g = lift(connection.group, segments, np.zeros(connection.r))[-1]
        return connection.group.inverse(g)


@checks_arguments
@Wait("computes the flatness of a connection")
def flatness(
    connection: ConnectionSource, limits: ArrayLike | None = None, *, samples: int | None = None
) -> Flatness:
    """Decide whether a connection is flat over a box of shapes.

    Args:
        connection: The connection, or a System for its mechanical connection.
        limits: (low, high) of each joint, (m, 2); ±1 by default.
        samples: Grid points per joint for up to three joints, else number of random shapes.
    Returns:
        The verdict with its numbers.
    Raises:
        InputError: An argument is of the wrong kind, or the limits are invalid.
        SingularInertiaError: A is undefined at a sampled shape.
    """
    connection = connection_of(connection, "flatness").in_chart()
    m, n = connection.m, connection.group.linear
    bounds = np.tile([-1.0, 1.0], (m, 1)) if limits is None else as_floats(limits, "limits")
    if bounds.shape != (m, 2) or not np.isfinite(bounds).all() or (np.diff(bounds) <= 0.0).any():
        raise InputError(f"limits must be (low, high) of each of {m} joints, got {limits!r}")
    if samples is not None:
        samples = whole(samples, "samples", most=int(_MOST_SHAPES ** (1.0 / max(1, m * (m <= 3)))))
    if 1 <= m <= 3:
        count = samples or _SAMPLES[m]
        axes = [np.linspace(low, high, count) for low, high in bounds]
        x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, m)
    else:
        rng = np.random.default_rng(0)
        x = rng.uniform(bounds[:, 0], bounds[:, 1], (samples or _RANDOM, m))
    field = connection.grid(x)
    B, exterior, bracket = field.curvature, field.exterior, field.bracket
    terms = np.abs(exterior) + np.abs(bracket)
    if m:  # ∂_αA_β and ∂_βA_α may cancel, so add the size of their terms
        terms = terms + np.abs(field.local).max(axis=(1, 2), keepdims=True)[..., None] ** 2

    def largest(rows: slice) -> tuple[float, float]:
        size = float(np.abs(B[:, rows]).max(initial=0.0))
        scale = float(terms[:, rows].max(initial=0.0))
        return size, size / scale if scale > 0.0 else 0.0

    attitude, pose = largest(slice(n, None)), largest(slice(None))
    sizes = np.abs(B).max(axis=(1, 2, 3)) if B.size else np.zeros(len(x))
    return Flatness(
        curvature=(attitude[0], pose[0]),
        relative=(attitude[1], pose[1]),
        attitude_is_flat=attitude[1] <= _FLAT,
        is_flat=pose[1] <= _FLAT,
        worst=x[int(np.argmax(sizes))].copy(),
        connection=connection,
        reference=bounds.mean(axis=1),
    )
