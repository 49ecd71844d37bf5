"""reorient(): the motion of the joints that turns the base as asked, from rest to rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ...analysis.connections.connection import Connection
from ...analysis.gaits.coefficients import coefficients_of
from ...analysis.gaits.gait import Gait
from ...analysis.phases.path_basis import path_lift
from ...analysis.phases.phase import phase
from ...common.arrays import Array, as_floats, positive, vector, whole
from ...common.errors import (
    InputError,
    IntegrationError,
    NoOptimum,
    SingularInertiaError,
)
from ...lie.rotations import quaternion_log
from ...scene import input_formats
from ...system.system import System, checked_system
from ..optimisation.aims import Reach, reach
from ..optimisation.limits import Limits, LimitsLike, limits_of
from ..optimisation.margins import margins
from ..optimisation.search import Lost
from ..optimisation.transcription import Passage, Task
from .time_law import Peaks, peaks_of
from .tumble import joints_share, momentum_of, passage_of, twist_left
from .turn_plan import TurnPlan
from .turning_loop import fine_path, turning_loop

CYCLES = (1, 2, 3, 4, 6, 8, 12, 16)
_LEFT = 1e-10  # rad a cycle; what may remain, at most
_SECONDS = 2.0  # a cycle


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
    """Return the joint motion that turns the base to a target, from rest to rest of the joints.

    target: rotation vector (3,) or angle [rad] in the frame where the base starts, or a pose,
        whose attitude is taken: where the base is follows from its centre of mass.
    limits, speeds, torques: of joints, in the forms that optimise_gait takes.
    x0: shape in which the motion starts and ends; zero if not given, or the middle of the limits
        where they leave that out.
    momentum: 0, or the body momentum at the start, (r,).  Then the base tumbles on the way, passes
        through the target in the end, and keeps the twist `TurnPlan.left`, which conservation
        fixes: no joint motion that ends in x0 leaves less.  Whole turns of an angle do not count.
    cycles: n, of equal loops; at zero momentum each turns the base by the n-th root of the target.
        As few as will do if not given.
    duration: of all of it [s]; 2 s a cycle if not given, or as long as speeds and torques need.

    Raises InputError for what makes no sense, SymmetryError for a base that gravity turns,
    NoOptimum if no loop within the limits was found.
    """
    system = checked_system(system, "reorient")
    connection, group = Connection.mechanical(system), system.group
    if not group.turns:
        raise InputError(f"the group {group.name} has no rotation")
    connection.refuse_gravity()
    if system.m < 2:
        raise InputError("a loop needs two joints: with one, every way back is the way there")
    bounds = limits_of(connection, limits, speeds, torques)
    start = _start(system, bounds, x0)
    turn = _turn(system, target)
    mu = momentum_of(system, momentum)
    if mu.any() and np.isfinite(bounds.torque).any():
        raise InputError(
            "torques= is for zero momentum, where they scale with the duration; with momentum see "
            "`plan.trajectory.driving_torques`"
        )
    numbers = CYCLES if cycles is None else (whole(cycles, "cycles"),)
    if not (np.linalg.norm(turn) > 0.0 or mu.any()):
        raise InputError("the target is where the base is: nothing has to move")
    asked = _Asked(system, connection, turn, start, bounds, mu, duration)
    why = ""
    # With momentum every number of cycles is another problem; those that steps solve come first.
    for quick in (True, False) if mu.any() else (False,):
        for n in numbers:
            try:
                return _tumbling(asked, n, quick=quick) if mu.any() else _still(asked, n)
            except (Lost, SingularInertiaError, IntegrationError) as error:
                why = str(error)
    raise NoOptimum(
        f"no loop from {start} turns '{system.name}' by the target in {numbers[-1]} cycles or "
        f"less ({why}); give wider limits, another x0, or more cycles"
    )


@dataclass(frozen=True, eq=False)
class _Asked:
    """What is asked for: the turn (turns,), the shape at both ends (m,), the body momentum (r,)."""

    system: System
    connection: Connection
    turn: Array
    start: Array
    bounds: Limits
    momentum: Array
    duration: float | None

    def task(self, aim: Reach, passage: Passage | None = None) -> Task:
        """Return the task of the shortest loop with an aim."""
        limits = _of_shape(self.bounds)
        return Task(self.connection, aim, "length", None, limits, 1.0, passage)


def _start(system: System, bounds: Limits, x0: ArrayLike | Mapping[str, ArrayLike] | None) -> Array:
    """Return the shape at the start, (m,).  Raises InputError outside the limits."""
    if x0 is None:
        zero = np.zeros(system.m)
        inside = (bounds.shape[:, 0] < 0.0) & (bounds.shape[:, 1] > 0.0)
        return np.where(inside, zero, bounds.middle)
    given = input_formats.order_by_joint(x0, system, "x0")
    start = vector(np.asarray(given), system.m, "x0", system.shape_names)
    if ((start <= bounds.shape[:, 0]) | (start >= bounds.shape[:, 1])).any():
        raise InputError(f"x0 must lie within the limits {bounds.shape.tolist()}, got {start}")
    return start


def _turn(system: System, target: ArrayLike) -> Array:
    """Return the target as a rotation vector or an angle, (turns,)."""
    group = system.group
    if group.turns == 1 and np.ndim(target) == 0:
        return vector(np.atleast_1d(as_floats(target, "target")), 1, "target")
    aim = reach(group, target)
    if np.shape(target) == (group.turns,):
        return vector(np.asarray(target, dtype=float), group.turns, "target")
    if group.turns == 1:
        return aim.attitude
    return quaternion_log(aim.attitude)


def _still(asked: _Asked, n: int) -> TurnPlan:
    """Return the plan of n cycles at zero momentum, judged by samples of its own.  Raises Lost."""
    group, connection, turn = asked.system.group, asked.connection, asked.turn
    gait = turning_loop(asked.task(reach(group, turn / n)), asked.start, turn / n)
    once = phase(connection, gait, tolerance=1e-13)
    end = once.cycles(n)
    if group.turns == 1:  # whole turns count
        end = np.append(end[:-1], n * once.pose[-1])
    peaks = peaks_of(connection, gait, n)
    return _plan(asked, gait, n, reach(group, turn), end, _seconds(asked, peaks, n), peaks)


def _tumbling(asked: _Asked, n: int, *, quick: bool) -> TurnPlan:
    """Return the plan of n cycles with momentum, judged by twice as many pieces.  Raises Lost."""
    system, start = asked.system, asked.start
    seconds = _SECONDS * n if asked.duration is None else positive(asked.duration, "duration")
    passage = passage_of(system, asked.momentum, start, n, seconds)
    aim, share = joints_share(system, passage, start, reach(system.group, asked.turn))
    gait = turning_loop(asked.task(aim, passage), start, share / n, quick=quick)
    peaks = peaks_of(asked.connection, gait, n)
    if seconds < (room := peaks.needed(asked.bounds)):
        raise InputError(
            f"speeds need {room:.3g} s of {n} cycles, but they take {seconds:g} s; give another "
            "duration, which decides how far the base drifts"
        )
    path = fine_path(system.m, start, passage, finer=2)
    end = path_lift(asked.connection, path.basis, coefficients_of(gait), passage.drift).pose
    return _plan(asked, gait, n, aim, end, seconds, peaks)


def _seconds(asked: _Asked, peaks: Peaks, n: int) -> float:
    """Return the duration: as given, or as long as limits need."""
    room = peaks.needed(asked.bounds)
    if asked.duration is None:
        return max(_SECONDS * n, room)
    seconds = positive(asked.duration, "duration")
    if seconds < room:
        raise InputError(f"speeds and torques need {room:.3g} s, got duration {seconds:g}")
    return seconds


def _plan(
    asked: _Asked, gait: Gait, n: int, aim: Reach, end: Array, seconds: float, peaks: Peaks
) -> TurnPlan:
    """Return the plan that ends at a pose.  Raises Lost if that is not the target."""
    remaining = float(np.linalg.norm(aim.missed(end)[0]))
    if not remaining <= n * _LEFT:
        raise Lost(f"the loop leaves {remaining:.1e} rad of the target")
    own = margins(asked.connection, gait, _of_shape(asked.bounds))
    return TurnPlan(
        system=asked.system, aim=aim, gait=gait.lasting(seconds / n), cycles=n, duration=seconds,
        pose=end, remaining=remaining, momentum=asked.momentum,
        left=twist_left(asked.system, asked.momentum, asked.start, end),
        margins=own | peaks.margins(asked.bounds, seconds),
    )  # fmt: skip


def _of_shape(limits: Limits) -> Limits:
    """Return the limits of joints alone: speeds and torques decide how long it takes."""
    free = np.full(len(limits.speed), np.inf)
    return Limits(limits.shape, free, free.copy())
