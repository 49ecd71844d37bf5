"""The phase of a gait or of a free rigid body: the displacement of the base over one cycle.

The body twists along the gait are evaluated or interpolated at Gauss nodes. On a gait that is one
Fourier series, everything is smooth and periodic. The trigonometric interpolant of N samples then
converges spectrally, and is evaluated at the Gauss nodes of N/2 segments. On any other gait, the
connection is evaluated at the Gauss nodes of its arcs.

The screw of a pose (Chasles): the steady drift or orbit that produces the pose.

Closure of gaits that turn joints: a complete turn must restore the robot.

The body momentum of a free rigid body traces a closed curve on a sphere, with the period T of
Jacobi's elliptic functions. Over one period the body rotates about the fixed J by

    Δθ = 2 E T / |J| − Λ   (modulo complete rotations),

with the signed solid angle Λ that the curve encloses. Period and solid angle are complete elliptic
integrals. Sources: R. Montgomery, "How much does the
rigid body rotate?", Am. J. Phys. 59 (1991); L. Landau, E. Lifshitz, "Mechanics", §37.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, FrozenArrays, positive, vector, vector_or_zero, whole
from ...common.errors import InputError, IntegrationError, NoConvergence
from ...common.html import Rows, Summary
from ...common.waiting import Wait
from ...integrators.implicit.gauss_stages import tables
from ...lie.group import Group, PoseError
from ...lie.rotations import TAU
from ...reduction.pointwise_reduction import PointwiseReduction
from ...system.system import System, checked_system
from ..connections.connection import (
    Connection,
    ConnectionSource,
    connection_of,
    refuse_crossing,
    refuse_singular,
)
from ..connections.gaits_of_all_joints import AllJointsCode, along_joints
from ..connections.loop_connection import LoopConnectionCode
from .gait import Gait
from .lift import STAGES, PathSegments, in_space, in_space_by_momenta, lift, nodes

_STRAIGHT = 1e-12  # rotation below which a screw counts as a translation [rad]


@checks_arguments
@dataclass(frozen=True)
class Screw(FrozenArrays):
    """A rotation about an axis with a translation along it, in the initial frame of the base.

    Attributes:
        axis: Direction of the axis, (3,); without rotation, the direction of the translation.
        point: Point of the axis nearest to the origin, (3,) [m]; NaN without rotation.
        angle: Rotation [rad].
        slide: Translation along the axis [m].
    """

    axis: Array
    point: Array
    angle: float
    slide: float

    def __str__(self) -> str:
        axis = f"({', '.join(f'{value:.6g}' for value in self.axis)})"
        if self.angle:
            slide = f", slide {self.slide:.12g} m" if self.slide else ""
            return f"{self.angle:.12g} rad about {axis}{slide}"
        return f"none, but a slide of {self.slide:.12g} m along {axis}" if self.slide else "none"

    @property
    def radius(self) -> float:
        """Radius of the circle or helix of the base origin [m]; ∞ for a straight line."""
        return float(np.linalg.norm(self.point)) if np.isfinite(self.point).all() else np.inf


def screw_of(group: Group, pose: Array) -> Screw:
    """Compute the screw of a pose. A planar angle keeps its complete rotations."""
    log = group.log(pose)
    angles = log.copy()
    xi = in_space(group, log)
    v, w = xi[:3], xi[3:]
    angle = float(np.linalg.norm(w))
    if group.turns == 1:  # unlike its logarithm, the pose keeps complete rotations
        angles = np.array(pose[-1:])
    if angle < _STRAIGHT:
        slide = float(np.linalg.norm(v))
        axis = v / slide if slide > 0.0 else np.array([0.0, 0.0, 1.0])
        return Screw(axis, np.full(3, np.nan), 0.0, slide)
    axis = w / angle
    total = float(angles[0] * axis[2]) if group.turns == 1 else angle
    return Screw(axis, np.cross(w, v) / angle**2, total, float(v @ axis))


_REPEATS = 1e-9  # largest change of body twists over a complete turn, relative to the twists
_SAMPLES = 16  # number of shapes at which the turned robot is compared


def refuse_open(connection: Connection, gait: Gait) -> None:
    """Reject a gait that turns a joint whose complete turn does not restore the robot.

    Args:
        connection: Connection, in rotation vectors if there are ball joints.
        gait: Path in shape space that may turn joints.
    Raises:
        InputError: The path is open; the message names the joint.
    """
    if len(gait.turns) == connection.m and (joint := _open_joint(connection, gait)):
        raise InputError(
            "gait: only a joint whose complete turn restores the robot may turn, "
            f"got turns {gait.turns}, with a turn of '{joint}'"
        )


def is_closed(connection: Connection, gait: Gait) -> bool:
    """Return whether a connection repeats itself after the turns of a gait.

    Args:
        connection: Connection with as many joints as the gait.
        gait: Path in shape space that may turn joints.
    Returns:
        Whether all joints that turn are revolute, and a complete turn of each restores the
        connection; or are balls whose attitudes at both ends are equal.
    """
    return not _open_joint(connection.in_chart(), gait)


def turns_ball(connection: Connection, gait: Gait) -> bool:
    """Return whether a gait turns a ball, so that its rotation vector does not return."""
    chart = connection.chart
    return chart is not None and bool(gait.rise[chart.space.ball_v].any())


def _open_joint(connection: Connection, gait: Gait) -> str:
    """Return a joint whose complete turn does not restore the connection, or ""."""
    rise, chart = gait.rise, connection.chart
    if chart is not None:
        start, _ = gait.at(0.0)
        if ball := chart.open_ball(start, start + rise):
            return ball
        rise[chart.space.ball_v] = 0.0
    x, xdot = gait.samples(_SAMPLES)
    xi = connection.code.velocities(x, xdot).xi
    size = float(np.abs(xi).max(initial=0.0))
    is_closed_loop = isinstance(connection.code, AllJointsCode | LoopConnectionCode)
    for k in np.flatnonzero(rise).tolist():
        # Joints of a closed loop may turn together although none of them can turn alone.
        alone = TAU * np.eye(connection.m)[k]
        shapes = x + (rise if is_closed_loop else alone)
        change = float(np.abs(connection.code.velocities(shapes, xdot).xi - xi).max(initial=0.0))
        if connection.form.units[k] != "rad" or not change <= _REPEATS * size:
            return connection.joints[k]
    return ""


_FLOOR = 64.0 * np.finfo(float).eps  # round-off, relative to the path length of the base
_LEAST = 1e-14  # smallest tolerance

_LEAST_SAMPLES = 16  # smallest number of samples of a smooth gait
_PER_HARMONIC = 16  # initial number of samples per harmonic
MOST = 2**15  # largest number of samples


@checks_arguments
@dataclass(frozen=True, eq=False, repr=False)
class Phase(Summary, FrozenArrays):
    """The motion of the base over one cycle of a gait.

    Attributes:
        group: Symmetry group.
        pose: Group element g of the cycle, (size,); the base starts at the identity.
        error: Estimated error, the difference from the pose with half as many samples: rotation
            [rad] and translation [m].
        geometric: Geometric phase, the end of the horizontal lift, (size,); equal to g at zero
            momentum.
        momentum: Body momentum at the start of the cycle, (r,).
        times: Times of the path, (P + 1,) [s].
        path: Poses during the cycle, (P + 1, size).
        length: Length of the gait, ∫√(ẋᵀMẋ) dt; NaN if the connection has no metric.
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

    def title(self) -> str:
        """Return the first line of the text."""
        return f"one cycle of {self.times[-1]:g} s moves the base in {self.group.name}"

    def rows(self) -> Rows:
        """Return the rows of the text: the pose with its error, its factors and its screw."""
        rows = [("pose", self.in_words(self.pose))]
        error = self.error
        rows.append(("error at most", f"{error.rotation:.1e} rad, {error.translation:.1e} m"))
        if self.momentum.any():
            rows.append(("geometric", self.in_words(self.geometric)))
            rows.append(("dynamic", self.in_words(self.dynamic)))
        rows.append(("turn", str(self.screw)))
        if self.length == self.length:  # not NaN
            rows.append(("length of the gait", f"{self.length:.12g}, in the connection's metric"))
        return [*rows, ("samples", str(self.samples))]

    def in_words(self, pose: Array) -> str:
        """Return the names and values of a pose in one line.

        Args:
            pose: Pose, (size,).
        """
        named = zip(self.group.pose_names, vector(pose, self.group.size, "pose"), strict=True)
        return "  ".join(f"{name} {value:.12g}" for name, value in named)

    @cached_property
    def dynamic(self) -> Array:
        """Dynamic factor of the pose, (size,), with g = dynamic · geometric.

        The factor is the identity at zero momentum.
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

    def fine_path(self, count: int) -> tuple[Array, Array]:
        """Return more poses during the cycle than `path` has, for drawings.

        Args:
            count: Least number of intervals.
        Returns:
            Times, (N + 1,) [s], and poses, (N + 1, size), with N at least `count`; all entries of
            `times` are among the times.
        """
        subdivisions = -(-whole(count, "count", 1) // len(self._segments.h))
        segments = _subdivided(self._segments, subdivisions)
        times = np.concatenate([[0.0], np.cumsum(segments.h)])
        return times, lift(self.group, segments, self.momentum)

    def cycles(self, n: int) -> Array:
        """Return the pose after n cycles.

        With momentum, cycles are computed one after another, because μ rotates with the body.

        Args:
            n: Number of cycles. It may be negative at zero momentum.
        Returns:
            Pose coordinates after n cycles, (size,).
        Raises:
            InputError: n is negative and the momentum is not zero.
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


@checks_arguments
@Wait("computes the phase of a gait")
def phase(
    connection: ConnectionSource,
    gait: Gait,
    momentum: ArrayLike | float = 0,
    *,
    tolerance: float = 1e-10,
) -> Phase:
    """Compute the phase of a gait: the pose g after one cycle of g⁻¹ġ = −A ẋ + P_b⁻¹ μ.

    The number of samples is doubled until the pose changes by less than the tolerance. On a
    Fourier series, convergence is spectral.

    Args:
        connection: Connection that lifts the gait, or a System for its mechanical connection. The
            gait of balls is in rotation vectors, about the centre of `Connection.in_chart` or rest.
        gait: Closed path in shape space: of independent or of all joints of a robot with loops.
        momentum: 0, or the body momentum μ at the start, (r,). Ad*_{g⁻¹} μ is conserved.
        tolerance: Tolerance of the pose, in rotation [rad] and translation [m].
    Returns:
        The phase with its error estimate.
    Raises:
        SymmetryError: Gravity rotates the base, so momentum is not conserved.
        SingularInertiaError: The gait meets a singular shape.
        IntegrationError: The tolerance is not reached with the largest number of samples.
        InputError: An argument is of the wrong kind, or gait and connection do not match.
    """
    if not isinstance(gait, Gait):
        raise InputError(f"phase takes a Connection and a Gait, got {type(gait).__name__}")
    connection = connection_of(connection, "phase").in_chart()
    connection, gait = along_joints(connection, gait)
    connection.refuse_gravity()
    refuse_open(connection, gait)
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
                    error=_bound(group, difference, path),
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


def _bound(group: Group, difference: PoseError, path: Array) -> PoseError:
    """Return the change of the pose in the last doubling of the samples, plus round-off."""
    steps = group.error(path[:-1], path[1:])
    rotation, translation = 1.0 + steps.rotation.sum(), steps.translation.sum()
    return PoseError(
        rotation=difference.rotation + _FLOOR * rotation,
        translation=difference.translation + _FLOOR * rotation * translation,
    )


def _momentum(connection: Connection, momentum: ArrayLike | float) -> Array:
    mu = vector_or_zero(momentum, connection.r, "momentum", connection.group.momentum_names)
    if mu.any() and not connection.form.momentum:
        raise InputError(f"{connection.form.what} define no momentum. Omit momentum=.")
    return mu


def _subdivided(segments: PathSegments, parts: int) -> PathSegments:
    """Return the same path with every segment divided into equal parts.

    Args:
        segments: The path, whose twists are polynomials through the Gauss nodes of a segment.
        parts: Number of parts of each segment.
    """
    from scipy.interpolate import barycentric_interpolate

    at = ((np.arange(parts)[:, None] + nodes()) / parts).ravel()
    weights = barycentric_interpolate(nodes(), np.eye(STAGES), at)

    def between(values: Array) -> Array:
        fine = np.einsum("si,pi...->ps...", weights, values)
        return np.ascontiguousarray(fine.reshape(-1, STAGES, *values.shape[2:]))

    h = np.repeat(segments.h / parts, parts)
    return PathSegments(h=h, a=between(segments.a), L=between(segments.L))


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


@dataclass(frozen=True)
class Sampled:
    """A gait with the body twists that the connection determines at its samples.

    Attributes:
        segments: Body twists at the Gauss nodes.
        samples: Number of shapes at which the connection was evaluated.
        length: Length of the gait, ∫√(ẋᵀMẋ) dt; NaN if the connection has no metric.
    """

    segments: PathSegments
    samples: int
    length: float


class Samples(NamedTuple):
    """Values of a connection at N shapes and rates.

    Attributes:
        xi: Body twists −A ẋ, (N, r).
        inverse: Entries of P_b⁻¹ in row-major order, (N, r²), or (N, 0) if not requested.
        speed: Speed in the metric, √(ẋᵀMẋ), (N,).
        health: Condition measure of P_b, (N,), which changes sign across a singular shape.
    """

    xi: Array
    inverse: Array
    speed: Array
    health: Array


def refined(connection: Connection, gait: Gait, *, momentum: bool) -> Iterator[Sampled]:
    """Sample a gait repeatedly, each time twice as finely, up to MOST samples.

    Args:
        connection: Connection to evaluate.
        gait: Closed path in shape space.
        momentum: Whether P_b⁻¹ is evaluated as well, as a non-zero momentum requires.
    Yields:
        The sampled gait.
    Raises:
        InputError: Gait and connection have different numbers of joints.
    """
    if connection.m != gait.m:
        raise InputError(
            f"gait: expected {connection.m} joints for {connection.title()}, got {gait.m}. "
            f"The joints are {', '.join(connection.joints)}"
        )
    # The attitude of a ball that turns is not a periodic function of time, so that the body twist
    # cannot be interpolated by a Fourier series.
    periodic = gait.is_smooth and not turns_ball(connection, gait)
    yield from (_smooth if periodic else _by_arcs)(connection, gait, momentum)


def _smooth(connection: Connection, gait: Gait, momentum: bool) -> Iterator[Sampled]:
    (arc,) = gait.arcs
    harmonics = len(getattr(arc, "cos", ()))
    count = max(_LEAST_SAMPLES, _PER_HARMONIC * harmonics)
    coarse: Samples | None = None
    while count <= MOST:
        # Every second sample is known from the previous, coarser sampling.
        step = gait.period / count
        t = np.arange(count) * step if coarse is None else np.arange(1, count, 2) * step
        samples = _at(connection, *gait.at(t), momentum)
        if coarse is not None:
            samples = Samples(*(_interleave(a, b) for a, b in zip(coarse, samples, strict=True)))
        coarse = samples
        refuse_crossing(connection.form, samples.health)
        segments = PathSegments(
            h=np.full(count // 2, gait.period / (count // 2)),
            a=in_space(connection.group, _interpolated(samples.xi)),
            L=_inverse_in_space(connection, _interpolated(samples.inverse))
            if momentum
            else _NOTHING,
        )
        yield Sampled(segments, count, float(samples.speed.mean() * gait.period))
        count *= 2


def _by_arcs(connection: Connection, gait: Gait, momentum: bool) -> Iterator[Sampled]:
    per_arc = 1
    while STAGES * per_arc * len(gait.arcs) <= MOST:
        starts = np.arange(per_arc) / per_arc
        s = (starts[:, None] + nodes() / per_arc).ravel()
        arc_points = [arc.at(s) for arc in gait.arcs]
        x = np.concatenate([points[0] for points in arc_points])
        xdot = np.concatenate(
            [points[1] / arc.time for points, arc in zip(arc_points, gait.arcs, strict=True)]
        )
        samples = _at(connection, x, xdot, momentum)
        refuse_crossing(connection.form, samples.health)
        h = np.repeat([arc.time / per_arc for arc in gait.arcs], per_arc)
        shape = (len(h), STAGES)
        segments = PathSegments(
            h=h,
            a=in_space(connection.group, samples.xi).reshape(*shape, 6),
            L=_inverse_in_space(connection, samples.inverse.reshape(*shape, -1))
            if momentum
            else _NOTHING,
        )
        length = float((h[:, None] * tables(STAGES).b * samples.speed.reshape(shape)).sum())
        yield Sampled(segments, len(x), length)
        per_arc *= 2


_NOTHING = np.zeros((0, STAGES, 6, 6))


def _at(connection: Connection, x: Array, xdot: Array, momentum: bool) -> Samples:
    """Evaluate the connection at shapes and rates (N, m)."""
    velocities = connection.code.velocities(x, xdot)
    refuse_singular(connection.form, x, velocities.health)
    inverse: Array = np.zeros((len(x), 0))
    if momentum:
        inverse = np.asarray(np.linalg.inv(connection.locals_at(x)[2]).reshape(len(x), -1))
    speed = np.sqrt(np.maximum(velocities.square, 0.0))
    return Samples(velocities.xi, inverse, speed, velocities.health)


def _interleave(coarse: Array, midpoints: Array) -> Array:
    interleaved = np.empty((2 * len(coarse), *coarse.shape[1:]))
    interleaved[::2], interleaved[1::2] = coarse, midpoints
    return interleaved


def _inverse_in_space(connection: Connection, rows: Array) -> Array:
    """Embed rows (..., r²) of P_b⁻¹ as spatial maps, (..., 6, 6)."""
    r = connection.r
    return in_space_by_momenta(connection.group, rows.reshape(*rows.shape[:-1], r, r))


def _interpolated(values: Array) -> Array:
    """Interpolate values (N, k) trigonometrically at the Gauss nodes of N/2 segments."""
    count = len(values)
    shifts = _shifts(count)
    modes = np.fft.rfft(values, axis=0) / count  # wave numbers 0 … N/2
    half = count // 2
    # On N/2 equidistant nodes, wave numbers k and k − N/2 are indistinguishable, so add them.
    # Twice the real part of the positive wave numbers gives all of them.
    modes[1:half] *= 2.0
    shifted = shifts[..., None] * modes  # (8, N/2 + 1, k)
    folded = shifted[:, :half].copy()
    folded[:, 0] += shifted[:, half]
    return np.ascontiguousarray(np.moveaxis(np.fft.ifft(folded, axis=1).real * half, 0, 1))


@lru_cache(maxsize=32)
def _shifts(count: int) -> Array:
    """Return e^{ikδ}, (8, N/2 + 1), for the Gauss nodes δ of the first of N/2 segments."""
    k = np.arange(count // 2 + 1)
    return np.exp(1j * np.multiply.outer(nodes() * (4.0 * np.pi / count), k))


_ROUND_OFF = 4.0 * float(np.finfo(float).eps)  # relative error of the inertia tensor


@checks_arguments
@dataclass(frozen=True)
class RigidBodyPhase(FrozenArrays):
    """The motion of a free rigid body over one period of its body momentum.

    Attributes:
        period: Period T [s].
        angle: Rotation about J after one period, in [0, 2π) [rad].
        solid_angle: Signed solid angle Λ that the momentum curve encloses, below 4π [sr].
        dynamic: Dynamic phase 2 E T / |J| [rad]; angle = dynamic − solid_angle modulo 2π.
        axis: Direction of J in the initial body frame, (3,).
        energy: Rotational energy E [J].
        momentum: Magnitude |J| of the angular momentum [kg m²/s].
    """

    period: float
    angle: float
    solid_angle: float
    dynamic: float
    axis: Array
    energy: float
    momentum: float


@checks_arguments
def rigid_body_phase(system: System, omega: ArrayLike) -> RigidBodyPhase:
    """Compute the phase of a free rigid body.

    Args:
        system: System of group SO3 or SE3 without joints.
        omega: Initial angular velocity in the body frame, (3,) [rad/s].
    Returns:
        Period, rotation angle and solid angle.
    Raises:
        InputError: The system has joints or another group, omega is zero, or there is no period:
            on the separatrix of the middle axis, or for a body with equal moments.
    """
    remedy = "Lock its joints at a closed shape (lock=)."
    system = checked_system(system, "rigid_body_phase", remedy=remedy)
    group = system.group
    if group.turns != 3 or group.linear not in (0, 3):
        raise InputError(f"system: expected a body of SO3 or SE3, got {group.name}")
    if system.m:
        raise InputError(f"'{system.name}' has {system.m} joints. Lock them: load(…, lock={{…}})")
    w = vector(omega, 3, "omega")
    I = PointwiseReduction(system).locked_inertia(np.zeros(0))
    inertia_about_com = I[-3:, -3:]
    if group.linear:  # about the centre of mass
        inertia_about_com = inertia_about_com - I[3:, :3] @ np.linalg.solve(I[:3, :3], I[:3, 3:])
    moments, axes = np.linalg.eigh(inertia_about_com)
    if np.linalg.det(axes) < 0.0:
        axes[:, 1] *= -1.0
    rates = axes.T @ w
    mu = moments * rates
    J, energy = float(np.linalg.norm(mu)), 0.5 * float(mu @ rates)
    if not J > 0.0:
        raise InputError("omega: expected a non-zero vector; a body at rest has no period")
    period, solid_angle = _period_and_solid_angle(moments, rates, J)
    dynamic = 2.0 * energy * period / J
    return RigidBodyPhase(
        period=period,
        angle=float((dynamic - solid_angle) % TAU),
        solid_angle=solid_angle,
        dynamic=dynamic,
        axis=np.asarray(axes @ mu / J),
        energy=energy,
        momentum=J,
    )


def _period_and_solid_angle(moments: Array, rates: Array, J: float) -> tuple[float, float]:
    """Compute the period [s] and the signed solid angle [sr] of the curve of μ/|J|.

    The curve circles the principal axis k.  The middle axis is j.  Differences of J² and 2E are
    sums over the components, which do not cancel near the axes.

    Args:
        moments: Principal moments of inertia, increasing, (3,) [kg m²].
        rates: Angular velocity along the principal axes, which are right-handed, (3,) [rad/s].
        J: Magnitude of the angular momentum [kg m²/s].
    Returns:
        The period, and the solid angle, positive if the curve circles +k counterclockwise.
    Raises:
        InputError: The motion has no period.
    """
    from scipy.special import ellipkm1, elliprf, elliprj

    squares = moments * rates**2
    gaps = moments - moments[1]
    above = float(squares @ gaps)  # J² − 2 E b, of the middle moment b
    if not abs(above) > _ROUND_OFF * _scale_of_errors(moments, rates):
        raise InputError(
            "there is no period: the motion is on the separatrix of the middle axis, or the "
            "momentum is constant in the body (equal moments of inertia)"
        )
    i, k = (0, 2) if above > 0.0 else (2, 0)
    a, b, c = moments[[i, 1, k]]
    near = float(squares @ (moments - a))  # J² − 2 E a, of the same sign as `above`
    denominator = (c - b) * near
    complement = min((c - a) * above / denominator, 1.0)  # 1 − m
    period = 4.0 * float(ellipkm1(complement)) * np.sqrt(a * b * c / denominator)
    # At azimuth φ from axis i to axis j, cos²θ = (n₀ + g cos²φ)/(d₀ + g cos²φ).  Carlson's
    # integrals yield the mean of cos θ (NIST Digital Library of Mathematical Functions, §19.29).
    n0, n1 = abs(above) / (b * J**2), abs(near) / (a * J**2)
    d0, d1, g = abs(c - b) / (b * c), abs(c - a) / (a * c), abs(b - a) / (a * b)
    p, q = n1 * d0, d1 * n0
    quarter = n0 * (elliprf(0.0, p, q) + g * d0 / 3.0 * elliprj(0.0, p, q, n0 * d0))
    hand = 1.0 if i == 0 else -1.0
    return float(period), hand * (TAU - 4.0 * float(quarter))


def _scale_of_errors(moments: Array, rates: Array) -> float:
    """Return the change of J² − 2 E b per relative error of the inertia tensor.

    An error of the tensor rotates the principal axes by its ratio to the gap of their moments.
    """
    size = float(np.linalg.norm(rates))
    outer = moments[[0, 2]] * np.abs(rates[[0, 2]])
    return float(moments[2] * (outer @ (np.abs(rates[[0, 2]]) + 2.0 * size)))
