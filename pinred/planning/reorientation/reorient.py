"""reorient(): find a joint motion from rest to rest that rotates the base to a target.

`flight_search.py` finds motions of least effort.  The rest of this text is about loops.

A plan traverses its loop n times, and a cycloid makes the whole motion start and end at rest.  At
u = t/D, with total duration D, n (u − sin 2πu / 2π) cycles are completed (see `cycloid`).  At zero
momentum, speeds scale with 1/D and torques with 1/D².

A ball moves by rotation vectors w about its initial attitude, with rate J ẇ and torque J⁻ᵀ τ_w in
the axes of its child, where J is the right Jacobian of SO(3).

Joint motion can rotate a tumbling base but not stop it.  Once the joints are at rest, the body
twist is I⁻¹Ad_gᵀJ, fixed by the spatial momentum J, the attitude and the shape.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, overload

import numpy as np
from numpy.typing import ArrayLike

from ...analysis.connections.connection import Connection, ConnectionSource, rest_of, system_of
from ...analysis.phases.gait import Gait
from ...analysis.phases.lift import path_lift
from ...analysis.phases.phase import phase
from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, as_floats, positive, vector, vector_or_zero, whole
from ...common.errors import (
    InputError,
    IntegrationError,
    NoOptimum,
    ShapeError,
    SingularInertiaError,
)
from ...common.names import joint_index
from ...common.waiting import Wait
from ...lie.rotations import quaternion_log
from ...scene.initial_state import order_by_joint
from ...system.system import System, checked_system
from ..optimisation.gait_search import Passage, StartFailed, Task
from ..optimisation.limits import Limits, LimitsLike, limits_of, margins, require_two_joints
from ..optimisation.objective import TargetAim, target_aim
from .turning_loop import (
    Peaks,
    TurnPlan,
    final_twist,
    fine_path,
    joint_rotation,
    passage_of,
    peaks_of,
    turning_loop,
)

if TYPE_CHECKING:
    from .flight_search import FlightPlan

CYCLES = (1, 2, 3, 4, 6, 8, 12, 16)  # numbers of cycles that are tried
_REMAINING = 1e-10  # largest error of the final attitude, per cycle [rad]
_TIMES = 512  # number of samples at which the rotation vectors of balls are checked
_SECONDS = 2.0  # default duration of a cycle [s]


@overload
def reorient(
    system: ConnectionSource,
    target: ArrayLike,
    *,
    limits: LimitsLike | None = None,
    speeds: LimitsLike | None = None,
    torques: LimitsLike | None = None,
    x0: ArrayLike | Mapping[str, ArrayLike] | None = None,
    momentum: ArrayLike | float = 0,
    cycles: int | None = None,
    duration: float | None = None,
) -> TurnPlan: ...


@overload
def reorient(
    system: ConnectionSource,
    target: ArrayLike,
    *,
    limits: LimitsLike | None = None,
    speeds: LimitsLike | None = None,
    torques: LimitsLike | None = None,
    x0: ArrayLike | Mapping[str, ArrayLike] | None = None,
    momentum: ArrayLike | float = 0,
    duration: float,
    x_end: ArrayLike | Mapping[str, ArrayLike] | None = None,
    effort: Literal["torque", "rate"],
) -> FlightPlan: ...


@checks_arguments
@Wait("searches a motion that reorients the base")
def reorient(
    system: ConnectionSource,
    target: ArrayLike,
    *,
    limits: LimitsLike | None = None,
    speeds: LimitsLike | None = None,
    torques: LimitsLike | None = None,
    x0: ArrayLike | Mapping[str, ArrayLike] | None = None,
    momentum: ArrayLike | float = 0,
    cycles: int | None = None,
    duration: float | None = None,
    x_end: ArrayLike | Mapping[str, ArrayLike] | None = None,
    effort: Literal["torque", "rate"] | None = None,
) -> TurnPlan | FlightPlan:
    """Find a joint motion that rotates the base to a target, from rest to rest of the joints.

    At zero momentum, each of n cycles rotates the base by the n-th root of the target.  With
    momentum the base tumbles during the motion, passes through the target at the end, and keeps
    the twist `TurnPlan.left`.  Conservation fixes this twist for the final shape.  Velocity and
    effort limits of the robot file, and collisions between links, are not considered.

    With `effort`, the motion is not a loop.  It takes the given duration, and it has the least
    mean square of torques or rates that several starts of a nonlinear program find within the
    limits, which include rates and efforts of the robot file.  If the target is out of reach, the
    FlightPlan ends at the nearest attitude found, and states the shortest longer duration at which
    a coarse search lands, to one percent.

    Args:
        system: The system, or its mechanical connection. With closed loops, the independent joints
            of the connection move the robot; those of a System are chosen.
        target: Rotation vector (3,) or angle [rad] in the initial frame of the base, or a pose,
            of which only the attitude is used: the position follows from the centre of mass.
            With nonzero momentum, full turns of an angle are ignored.
        limits: Limits of joints, in the formats of optimise_gait; for axes of balls, limits of the
            rotation vector about the initial attitude.
        speeds: Largest speeds, in the same formats; for balls, in the axes of the child.
        torques: Largest torques, in the same formats; for balls, in the axes of the child.
        x0: Initial and final shape; by default at rest, or the middle of the limits if they
            exclude zero. With loops, values of the independent joints; by default the assembled
            shape.
        momentum: 0, or the initial body momentum, (r,).
        cycles: Number of equal loops; by default as few as possible.
        duration: Total duration [s]; by default 2 s per cycle, or as long as speeds and torques
            require. With effort, it must be stated.
        x_end: Final shape, with effort; by default the initial shape.
        effort: "torque" or "rate" for a motion with the least mean square of torques or rates; by
            default loops are planned.
    Returns:
        A TurnPlan of loops, or with effort a FlightPlan.
    Raises:
        InputError: The options are invalid or contradict each other.
        SymmetryError: Gravity rotates the base.
        NoOptimum: No loop within the limits was found.
    """
    system_or_connection, system = (
        system,
        checked_system(system_of(system, "reorient"), "reorient", loops=True),
    )
    group = system.group
    if isinstance(system_or_connection, Connection) and system.loops:
        connection = system_or_connection
    else:
        connection = Connection.mechanical(system)
        connection = connection if system.loops else connection.in_chart(_centre(system, x0))
    if not group.turns:
        raise InputError(f"the group {group.name} has no rotation")
    connection.refuse_gravity()
    if effort is None:
        require_two_joints(connection.m)
    bounds = limits_of(connection, limits, speeds, torques)
    start = _initial_shape(system, connection, bounds, x0)
    turn = _target_rotation(system, target)
    mu = vector_or_zero(momentum, system.r, "momentum", group.momentum_names)
    if effort is not None:
        from .flight_search import FlightRequest, file_limits, plan_flight  # needs CasADi

        if effort not in ("torque", "rate"):
            raise InputError(f'effort: expected "torque" or "rate", got {effort!r}')
        if cycles is not None:
            raise InputError("cycles: a motion of least effort is not a loop. Omit one of both")
        if duration is None:
            raise InputError("duration: a motion of least effort needs the time of flight [s]")
        end = start if x_end is None else _initial_shape(system, connection, bounds, x_end, "x_end")
        allowed = file_limits(
            system, bounds, speeds=speeds is not None, torques=torques is not None
        )
        seconds = positive(duration, "duration")
        return plan_flight(FlightRequest(system, turn, mu, seconds, (start, end), allowed, effort))
    if x_end is not None:
        raise InputError('x_end: loops end where they start. Pass effort="torque" or "rate" too')
    if mu.any() and np.isfinite(bounds.torque).any():
        raise InputError(
            "torques: limits of loops need zero momentum, where torques scale with the duration. "
            'With momentum, pass effort="torque" and a duration'
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
        start: Initial and final coordinates, (m,).
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


def _shape(system: System, x0: ArrayLike | Mapping[str, ArrayLike], what: str = "x0") -> Array:
    ordered = np.asarray(order_by_joint(x0, system, what))
    shape = vector(ordered, system.nx, what, system.x_names)
    return system.space.normalized(shape, what, near=False)


def _centre(system: System, x0: ArrayLike | Mapping[str, ArrayLike] | None) -> Array | None:
    """Return the centre of the rotation vectors of balls, (nx,); None without balls.

    It has the initial attitudes of balls, and zero for hinges and slides.
    """
    space = system.space
    if not space.balls:
        return None
    centre = space.neutral
    if x0 is not None:
        centre[space.ball_x] = _shape(system, x0)[space.ball_x]
    return centre


def _initial_shape(
    system: System,
    connection: Connection,
    bounds: Limits,
    x0: ArrayLike | Mapping[str, ArrayLike] | None,
    what: str = "x0",
) -> Array:
    """Return the coordinates of x0 or x_end, (m,).  Raises InputError if they exceed limits."""
    start = rest_of(connection)
    if x0 is None:
        inside = (bounds.shape[:, 0] < start) & (bounds.shape[:, 1] > start)
        return np.where(inside, start, bounds.middle)
    if system.loops:
        start = _independent_values(connection, start, x0, what)
    else:
        space = system.space
        start[space.scalar_v] = _shape(system, x0, what)[space.scalar_x]
    if ((start <= bounds.shape[:, 0]) | (start >= bounds.shape[:, 1])).any():
        raise InputError(f"{what} must lie within the limits {bounds.shape.tolist()}, got {start}")
    return start


def _independent_values(
    connection: Connection, rest: Array, x0: ArrayLike | Mapping[str, ArrayLike], what: str
) -> Array:
    """Return coordinates (d,) of independent joints; those that are not named are at rest."""
    if not isinstance(x0, Mapping):
        return vector(x0, connection.m, what, connection.joints)
    start, names = rest.copy(), list(connection.joints)
    for name, value in x0.items():
        start[joint_index(name, names, what)] = float(as_floats(value, f"{what}[{name!r}]"))
    return start


def _target_rotation(system: System, target: ArrayLike) -> Array:
    """Return the target as a rotation vector or an angle, (turns,)."""
    group = system.group
    if group.turns == 1 and np.ndim(target) == 0:
        return vector(np.atleast_1d(as_floats(target, "target")), 1, "target")
    shape = as_floats(getattr(target, "homogeneous", target), "target").shape
    if group.turns == 3 and len(shape) < 2 and shape not in ((3,), (group.size,)):
        raise ShapeError(
            f"target: expected a rotation vector (3,) [rad] or a pose ({group.size},), got shape "
            f"{shape}. For a turn about the z axis, pass [0, 0, angle]."
        )
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
    passage = passage_of(request.connection, request.momentum, start, n, seconds)
    target = target_aim(system.group, request.turn)
    aim, share = joint_rotation(system.group, passage, start, target)
    gait = turning_loop(request.task(aim, passage), start, share / n, quick=quick)
    peaks = peaks_of(request.connection, gait, n)
    if seconds < (shortest := peaks.needed(request.bounds)):
        raise InputError(
            f"speeds need {shortest:.3g} s for {n} cycles, but the duration is {seconds:g} s; give "
            "another duration, which also determines how far the base drifts, or plan another path "
            'with effort="torque"'
        )
    path = fine_path(request.connection.m, start, passage, finer=2)
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
            f"duration: limits of speeds and torques need {shortest:.3g} s for this loop, got "
            f"{seconds:g} s. Choose a longer duration, wider limits, or another path with "
            'effort="torque"'
        )
    return seconds


def _create_plan(
    request: _Request, gait: Gait, n: int, aim: TargetAim, end: Array, seconds: float, peaks: Peaks
) -> TurnPlan:
    """Return a plan with final pose `end`.  Raises StartFailed if it is not the target."""
    remaining = float(np.linalg.norm(aim.error(end)[0]))
    if not remaining <= n * _REMAINING:
        raise StartFailed(f"the final attitude misses the target by {remaining:.1e} rad")
    chart = request.connection.chart
    if chart is not None and (ball := chart.ball_beyond(gait.samples(_TIMES)[0])):
        raise StartFailed(f"the rotation vector of ball joint '{ball}' reaches 2π")
    shape_margins = margins(request.connection, gait, _shape_limits(request.bounds))
    return TurnPlan(
        system=request.system, aim=aim, gait=gait.lasting(seconds / n), cycles=n, duration=seconds,
        pose=end, remaining=remaining, momentum=request.momentum,
        left=final_twist(request.connection, request.momentum, request.start, end),
        connection=request.connection,
        margins=shape_margins | peaks.margins(request.bounds, seconds),
    )  # fmt: skip


def _shape_limits(limits: Limits) -> Limits:
    """Return only the joint limits, because speeds and torques only affect the duration."""
    free = np.full(len(limits.speed), np.inf)
    return Limits(limits.shape, free, free.copy())
