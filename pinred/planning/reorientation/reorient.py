"""reorient(): find a joint motion from rest to rest that rotates the base to a target.

A plan traverses its loop n times, and a cycloid makes the whole motion start and end at rest.  At
u = t/D, with total duration D, n (u − sin 2πu / 2π) cycles are completed (see `cycloid`).  At zero
momentum, speeds scale with 1/D and torques with 1/D².

Joint motion can rotate a tumbling base but not stop it.  Once the joints are at rest, the body
twist is I⁻¹Ad_gᵀJ, fixed by the spatial momentum J, the attitude and the shape.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ...analysis.connections.connection import Connection
from ...analysis.gaits.gait import Gait
from ...analysis.phases.lift import STAGES, PathSegments, in_space_by_momenta, lift
from ...analysis.phases.path_basis import Drift, cycloid, fourier_rows, path_lift
from ...analysis.phases.phase import phase
from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, FrozenArrays, as_floats, positive, vector, vector_or_zero, whole
from ...common.errors import InputError, IntegrationError, NoOptimum, SingularInertiaError
from ...lie.rotations import quaternion_log
from ...scene.joint_values import order_by_joint
from ...system.system import System, checked_system
from ..optimisation.gait_search import StartFailed
from ..optimisation.limits import Limits, LimitsLike, find_extremes, limits_of, margins
from ..optimisation.objective import TargetAim, rotation_between, target_aim, torques
from ..optimisation.transcription import Passage, Task
from .turn_plan import TurnPlan
from .turning_loop import fine_path, turning_loop

_TIMES = 512  # number of samples per cycle
_SAFETY = 1.0 + 1e-6  # factor on the shortest duration, for round-off


@dataclass(frozen=True, eq=False)
class Peaks(FrozenArrays):
    """Largest speed and torque of each joint for a total duration of 1 s.

    Attributes:
        speed: Largest speed of each joint, (m,).
        torque: Largest torque of each joint, (m,).
    """

    speed: Array
    torque: Array

    def needed(self, limits: Limits) -> float:
        """Return the shortest duration within limits [s]; zero if there are no limits."""
        by_speed = np.max(self.speed / limits.speed)
        by_torque = np.sqrt(np.max(self.torque / limits.torque))
        return float(_SAFETY * max(by_speed, by_torque))

    def margins(self, limits: Limits, duration: float) -> dict[str, float]:
        """Compute the smallest distance to the limits of speeds and torques.

        Args:
            limits: The limits.
            duration: Total duration [s].
        Returns:
            Distances by kind; kinds without limits are omitted.
        """
        distances: dict[str, float] = {}
        if np.isfinite(limits.speed).any():
            distances["speeds"] = float((limits.speed - self.speed / duration).min())
        if np.isfinite(limits.torque).any():
            distances["torques"] = float((limits.torque - self.torque / duration**2).min())
        return distances


def peaks_of(connection: Connection, gait: Gait, cycles: int) -> Peaks:
    """Compute the largest speeds and torques of a Fourier gait from rest to rest.

    Args:
        connection: The mechanical connection.
        gait: The gait.
        cycles: Number of cycles.
    Returns:
        The peaks for a total duration of 1 s.
    Raises:
        InputError: The connection has drag.
    """
    if not connection.form.momentum:
        raise InputError("reorient needs a mechanical connection, without drag")
    c = gait.series.coefficients()

    def motion(u: Array) -> tuple[Array, Array, Array]:
        angle, rate, bend = cycloid(u, cycles)
        x, x1, x2 = (rows @ c for rows in fourier_rows((len(c) - 1) // 2, angle, turn=1.0))
        return x, rate[:, None] * x1, rate[:, None] ** 2 * x2 + bend[:, None] * x1

    u = np.linspace(0.0, 1.0, _TIMES * cycles + 1)
    speed = find_extremes(lambda u: motion(u)[1], u)[1]
    torque = find_extremes(lambda u: torques(connection, *motion(u)), u)[1]
    return Peaks(speed, torque)


_TURN = 2.0 * np.pi
_PER_RADIAN = 4  # number of quadrature segments per radian of tumbling
_MOST = 200.0  # largest tumbling angle of a plan [rad]


def passage_of(system: System, momentum: Array, start: Array, cycles: int, time: float) -> Passage:
    """Create a motion from rest to rest with momentum.

    Args:
        system: The system.
        momentum: Initial body momentum, (r,).
        start: Initial shape, (m,).
        cycles: Number of cycles.
        time: Total duration [s].
    Returns:
        The motion, with enough quadrature segments to resolve the tumbling.
    Raises:
        InputError: The base would tumble too far.
    """
    drift = Drift(system, time * momentum)
    (inverse,) = drift.inverse(start[None])
    angle = float(np.linalg.norm((inverse @ drift.momentum)[system.group.linear :]))
    if not angle <= _MOST:
        raise InputError(
            f"with joints at rest the base would tumble through {angle:.3g} rad in {time:g} s; "
            "give a shorter duration"
        )
    return Passage(cycles, drift, int(_PER_RADIAN * angle) + 1)


def joint_rotation(
    system: System, passage: Passage, start: Array, aim: TargetAim
) -> tuple[TargetAim, Array]:
    """Compute the rotation that the joints must contribute to a target.

    Angles that differ by full turns are the same attitude, so the angle nearest to that of the
    drifted base is used.

    Args:
        system: The system.
        passage: The motion from rest to rest.
        start: Initial shape, (m,).
        aim: The target.
    Returns:
        The target, and the rotation to it from the attitude that the base would drift to with
        joints at rest, (turns,).
    """
    group, drift = system.group, passage.drift
    count = passage.more + STAGES
    inverse = in_space_by_momenta(group, drift.inverse(start[None]))
    still = PathSegments(
        h=np.full(count, 1.0 / count),
        a=np.zeros((count, STAGES, 6)),
        L=np.ascontiguousarray(np.broadcast_to(inverse, (count, STAGES, 6, 6))),
    )
    drifted = lift(group, still, drift.momentum)[-1][group.linear :]
    if group.turns == 1:
        turns = np.round((drifted - aim.attitude) / _TURN)
        aim = TargetAim(group, aim.attitude + _TURN * turns, None)
        return aim, np.asarray(aim.attitude - drifted)
    return TargetAim(group, aim.attitude, None), rotation_between(drifted, aim.attitude)


def final_twist(system: System, momentum: Array, shape: Array, pose: Array) -> Array:
    """Compute the twist I⁻¹Ad_gᵀJ of a base with joints at rest.

    Args:
        system: The system.
        momentum: Spatial momentum J, (r,).
        shape: Shape, (m,).
        pose: Pose, (size,).
    Returns:
        (r,): the body twist.
    """
    (inverse,) = Drift(system, momentum).inverse(shape[None])
    return np.asarray(inverse @ system.group.Ad(pose).T @ momentum)


CYCLES = (1, 2, 3, 4, 6, 8, 12, 16)  # numbers of cycles that are tried
_REMAINING = 1e-10  # largest error of the final attitude, per cycle [rad]
_SECONDS = 2.0  # default duration of a cycle [s]


@checks_arguments
def reorient(
    system: System,
    target: ArrayLike,
    *,
    limits: LimitsLike | None = None,
    speeds: LimitsLike | None = None,
    torques: LimitsLike | None = None,
    x0: ArrayLike | Mapping[str, ArrayLike] | None = None,
    momentum: ArrayLike | float = 0,
    cycles: int | None = None,
    duration: float | None = None,
) -> TurnPlan:
    """Find a joint motion that rotates the base to a target, from rest to rest of the joints.

    At zero momentum, each of n cycles rotates the base by the n-th root of the target.  With
    momentum the base tumbles during the motion, passes through the target at the end, and keeps
    the twist `TurnPlan.left`.  Conservation fixes this twist for the final shape.

    Args:
        system: The system.
        target: Rotation vector (3,) or angle [rad] in the initial frame of the base, or a pose,
            of which only the attitude is used: the position follows from the centre of mass.
            With nonzero momentum, full turns of an angle are ignored.
        limits: Limits of joints, in the formats of optimise_gait.
        speeds: Largest speeds, in the same formats.
        torques: Largest torques, in the same formats.
        x0: Initial and final shape; by default zero, or the middle of the limits if they
            exclude zero.
        momentum: 0, or the initial body momentum, (r,).
        cycles: Number of equal loops; by default as few as possible.
        duration: Total duration [s]; by default 2 s per cycle, or as long as speeds and torques
            require.
    Returns:
        The plan.
    Raises:
        InputError: The options are invalid or contradict each other.
        SymmetryError: Gravity rotates the base.
        NoOptimum: No loop within the limits was found.
    """
    system = checked_system(system, "reorient")
    system.space.refuse_balls("reorient")
    connection, group = Connection.mechanical(system), system.group
    if not group.turns:
        raise InputError(f"the group {group.name} has no rotation")
    connection.refuse_gravity()
    if system.m < 2:
        raise InputError("a loop needs two joints: a single joint can only retrace its path")
    bounds = limits_of(connection, limits, speeds, torques)
    start = _initial_shape(system, bounds, x0)
    turn = _target_rotation(system, target)
    mu = vector_or_zero(momentum, system.r, "momentum", group.twist_names)
    if mu.any() and np.isfinite(bounds.torque).any():
        raise InputError(
            "torques: limits need zero momentum, where torques scale with the duration. With "
            "momentum, see `plan.trajectory.driving_torques`"
        )
    cycle_counts = CYCLES if cycles is None else (whole(cycles, "cycles"),)
    if not (np.linalg.norm(turn) > 0.0 or mu.any()):
        raise InputError("the target is the initial attitude: nothing has to move")
    request = _Request(system, connection, turn, start, bounds, mu, duration)
    why = ""
    # With momentum, each number of cycles needs a separate loop; try fast Newton steps first.
    for quick in (True, False) if mu.any() else (False,):
        for n in cycle_counts:
            try:
                return (
                    _plan_with_momentum(request, n, quick=quick)
                    if mu.any()
                    else _plan_at_zero_momentum(request, n)
                )
            except (StartFailed, SingularInertiaError, IntegrationError) as error:
                why = str(error)
    raise NoOptimum(
        f"no loop from {start} rotates '{system.name}' to the target in {cycle_counts[-1]} cycles "
        f"or less ({why}); give wider limits, another x0, or more cycles"
    )


@dataclass(frozen=True, eq=False)
class _Request:
    """The validated arguments of `reorient`.

    Attributes:
        system: The system.
        connection: Mechanical connection of the system.
        turn: Requested rotation, (turns,) [rad].
        start: Initial and final shape, (m,).
        bounds: Limits of the joints.
        momentum: Initial body momentum, (r,).
        duration: Total duration [s], or None.
    """

    system: System
    connection: Connection
    turn: Array
    start: Array
    bounds: Limits
    momentum: Array
    duration: float | None

    def task(self, aim: TargetAim, passage: Passage | None = None) -> Task:
        """Return the task of finding the shortest loop that reaches a target."""
        limits = _shape_limits(self.bounds)
        return Task(self.connection, aim, "length", None, limits, 1.0, passage)


def _initial_shape(
    system: System, bounds: Limits, x0: ArrayLike | Mapping[str, ArrayLike] | None
) -> Array:
    """Return the initial shape, (m,).  Raises InputError if it is outside the limits."""
    if x0 is None:
        zero = np.zeros(system.m)
        inside = (bounds.shape[:, 0] < 0.0) & (bounds.shape[:, 1] > 0.0)
        return np.where(inside, zero, bounds.middle)
    ordered = order_by_joint(x0, system, "x0")
    start = vector(np.asarray(ordered), system.m, "x0", system.shape_names)
    if ((start <= bounds.shape[:, 0]) | (start >= bounds.shape[:, 1])).any():
        raise InputError(f"x0 must lie within the limits {bounds.shape.tolist()}, got {start}")
    return start


def _target_rotation(system: System, target: ArrayLike) -> Array:
    """Return the target as a rotation vector or an angle, (turns,)."""
    group = system.group
    if group.turns == 1 and np.ndim(target) == 0:
        return vector(np.atleast_1d(as_floats(target, "target")), 1, "target")
    aim = target_aim(group, target)
    if np.shape(target) == (group.turns,):
        return vector(np.asarray(target, dtype=float), group.turns, "target")
    if group.turns == 1:
        return aim.attitude
    return quaternion_log(aim.attitude)


def _plan_at_zero_momentum(request: _Request, n: int) -> TurnPlan:
    """Return a plan of n cycles, verified on independent samples.  Raises StartFailed."""
    group, connection, turn = request.system.group, request.connection, request.turn
    gait = turning_loop(request.task(target_aim(group, turn / n)), request.start, turn / n)
    once = phase(connection, gait, tolerance=1e-13)
    end = once.cycles(n)
    if group.turns == 1:  # preserve full turns
        end = np.append(end[:-1], n * once.pose[-1])
    peaks = peaks_of(connection, gait, n)
    return _create_plan(
        request, gait, n, target_aim(group, turn), end, _choose_duration(request, peaks, n), peaks
    )


def _plan_with_momentum(request: _Request, n: int, *, quick: bool) -> TurnPlan:
    """Return a plan of n cycles, verified with twice the quadrature nodes.  Raises StartFailed."""
    system, start = request.system, request.start
    seconds = _SECONDS * n if request.duration is None else positive(request.duration, "duration")
    passage = passage_of(system, request.momentum, start, n, seconds)
    aim, share = joint_rotation(system, passage, start, target_aim(system.group, request.turn))
    gait = turning_loop(request.task(aim, passage), start, share / n, quick=quick)
    peaks = peaks_of(request.connection, gait, n)
    if seconds < (shortest := peaks.needed(request.bounds)):
        raise InputError(
            f"speeds need {shortest:.3g} s for {n} cycles, but the duration is {seconds:g} s; give "
            "another duration, which also determines how far the base drifts"
        )
    path = fine_path(system.m, start, passage, finer=2)
    end = path_lift(request.connection, path.basis, gait.series.coefficients(), passage.drift).pose
    return _create_plan(request, gait, n, aim, end, seconds, peaks)


def _choose_duration(request: _Request, peaks: Peaks, n: int) -> float:
    """Return the requested duration, or by default a duration within the limits."""
    shortest = peaks.needed(request.bounds)
    if request.duration is None:
        return max(_SECONDS * n, shortest)
    seconds = positive(request.duration, "duration")
    if seconds < shortest:
        raise InputError(
            f"duration: limits of speeds and torques need {shortest:.3g} s, got {seconds:g} s. "
            "Choose a longer duration, or wider limits"
        )
    return seconds


def _create_plan(
    request: _Request, gait: Gait, n: int, aim: TargetAim, end: Array, seconds: float, peaks: Peaks
) -> TurnPlan:
    """Return a plan with final pose `end`.  Raises StartFailed if it is not the target."""
    remaining = float(np.linalg.norm(aim.error(end)[0]))
    if not remaining <= n * _REMAINING:
        raise StartFailed(f"the final attitude misses the target by {remaining:.1e} rad")
    shape_margins = margins(request.connection, gait, _shape_limits(request.bounds))
    return TurnPlan(
        system=request.system, aim=aim, gait=gait.lasting(seconds / n), cycles=n, duration=seconds,
        pose=end, remaining=remaining, momentum=request.momentum,
        left=final_twist(request.system, request.momentum, request.start, end),
        margins=shape_margins | peaks.margins(request.bounds, seconds),
    )  # fmt: skip


def _shape_limits(limits: Limits) -> Limits:
    """Return only the joint limits, because speeds and torques only affect the duration."""
    free = np.full(len(limits.speed), np.inf)
    return Limits(limits.shape, free, free.copy())
