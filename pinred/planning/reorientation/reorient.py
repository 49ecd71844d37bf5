"""reorient(): the motion of the joints that turns the base as asked, at zero momentum."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from ...analysis.connections.connection import Connection
from ...analysis.gaits.coefficients import coefficients_of
from ...analysis.gaits.gait import Gait
from ...analysis.phases.path_basis import path_lift
from ...analysis.phases.phase import phase
from ...common.arrays import Array, positive, vector
from ...common.errors import (
    InputError,
    IntegrationError,
    NoOptimum,
    SingularInertiaError,
    SymmetryError,
)
from ...lie.rotations import quaternion_log
from ...reduction.potential import pivot_weight
from ...scene import forms
from ...system.system import System, checked_system
from ..optimisation.aims import Reach, reach
from ..optimisation.limits import Limits, LimitsLike, limits_of
from ..optimisation.margins import margins
from ..optimisation.search import Lost, Search, fourier_path_of, within
from ..optimisation.transcription import Task, fourier_path
from .first_loops import first_loop
from .newton_polish import polished
from .time_law import peaks_of
from .turn_plan import TurnPlan

CYCLES = (1, 2, 3, 4, 6, 8, 12, 16)
_HARMONICS = 3
_ITERATIONS = 150
_REACHED = 1e-5  # rad; what the polish starts from, at most
_LEFT = 1e-10  # rad a cycle; what it leaves, at most
_FINE = 64  # pieces of order 16 of the polish
_SECONDS = 2.0  # a cycle


def reorient(
    system: System,
    target: ArrayLike,
    *,
    limits: LimitsLike | None = None,
    speeds: LimitsLike | None = None,
    torques: LimitsLike | None = None,
    x0: ArrayLike | Mapping[str, ArrayLike] | None = None,
    cycles: int | None = None,
    duration: float | None = None,
) -> TurnPlan:
    """Return the joint motion that turns the base to a target at zero momentum, rest to rest.

    target: rotation vector (3,) or angle [rad] in the frame where the base starts, or a pose,
        whose attitude is taken: where the base is follows from its centre of mass.
    limits, speeds, torques: of joints, in the forms that optimise_gait takes.
    x0: shape in which the motion starts and ends; zero if not given, or the middle of the limits
        where they leave that out.
    cycles: n, of equal loops that each turn the base by the n-th root of the target; as few as
        will do if not given.
    duration: of all of it [s]; 2 s a cycle if not given, or as long as speeds and torques need.

    Raises InputError for what makes no sense, SymmetryError for a pivoted base that gravity turns,
    NoOptimum if no loop within the limits was found.
    """
    system = checked_system(system, "reorient")
    connection, group = Connection.mechanical(system), system.group
    if not group.turns:
        raise InputError(f"the group {group.name} has no rotation")
    if pivot_weight(system).any():
        raise SymmetryError(
            f"gravity turns the base of '{system.name}', so that its momentum does not stay zero; "
            "take gravity=(0, 0, 0)"
        )
    if system.m < 2:
        raise InputError("a loop needs two joints: with one, every way back is the way there")
    bounds = limits_of(connection, limits, speeds, torques)
    start = _start(system, bounds, x0)
    turn = _turn(system, target)
    numbers = CYCLES if cycles is None else (_whole(cycles),)
    if not np.linalg.norm(turn) > 0.0:
        raise InputError("the target is where the base is: nothing has to move")
    why = ""
    shape_only = _of_shape(bounds)
    for n in numbers:
        aim = reach(group, turn / n)
        try:
            gait = _loop(Task(connection, aim, "length", None, shape_only, 1.0), start, turn / n)
            return _plan(system, connection, gait, n, turn, bounds, duration)
        except (Lost, SingularInertiaError, IntegrationError) as error:
            why = str(error)
    raise NoOptimum(
        f"no loop from {start} turns '{system.name}' by the target in {numbers[-1]} cycles or "
        f"less ({why}); give wider limits, another x0, or more cycles"
    )


def _start(system: System, bounds: Limits, x0: ArrayLike | Mapping[str, ArrayLike] | None) -> Array:
    """Return the shape at the start, (m,).  Raises InputError outside the limits."""
    if x0 is None:
        zero = np.zeros(system.m)
        inside = (bounds.shape[:, 0] < 0.0) & (bounds.shape[:, 1] > 0.0)
        return np.where(inside, zero, bounds.middle)
    given = forms.in_order(x0, system, "x0")
    start = vector(np.asarray(given), system.m, "x0", system.shape_names)
    if ((start <= bounds.shape[:, 0]) | (start >= bounds.shape[:, 1])).any():
        raise InputError(f"x0 must lie within the limits {bounds.shape.tolist()}, got {start}")
    return start


def _turn(system: System, target: ArrayLike) -> Array:
    """Return the target as a rotation vector or an angle, (turns,)."""
    group = system.group
    if group.turns == 1 and np.ndim(target) == 0:
        return vector(np.atleast_1d(np.asarray(target, dtype=float)), 1, "target")
    aim = reach(group, target)
    if np.shape(target) == (group.turns,):
        return vector(np.asarray(target, dtype=float), group.turns, "target")
    if group.turns == 1:
        return aim.attitude
    return quaternion_log(aim.attitude)


def _whole(cycles: int) -> int:
    if isinstance(cycles, bool) or int(cycles) != cycles or cycles < 1:
        raise InputError(f"cycles must be a whole number from 1 on, got {cycles!r}")
    return int(cycles)


def _loop(task: Task, start: Array, turn: Array) -> Gait:
    """Return a loop from a shape that turns the base by a rotation vector.  Raises Lost."""
    connection = task.connection
    gait = first_loop(connection, start, turn, task.limits.shape)
    search = Search(task, fourier_path_of(task, _HARMONICS, start=start))
    best = search.from_gait(gait, most=_ITERATIONS)
    if not _missed(search, best.z) <= _REACHED:
        raise Lost(f"the optimiser stopped short of the target ({best.status})")
    search, best = within(search, best, _HARMONICS, start)
    fine = fourier_path(
        _HARMONICS, connection.m, pieces=_FINE, checks=np.zeros(1), power=1, start=start
    )
    if not isinstance(task.aim, Reach):
        raise InputError("a loop that turns the base has a target")
    rough = search.gait(best.z)
    y = polished(connection, task.aim, fine, fine.unknowns(coefficients_of(rough)))
    found = Search(task, fine).gait(y)
    if margins(connection, found, task.limits)["limits"] < 0.0:
        raise Lost("the polished loop goes beyond the limits")
    return found


def _missed(search: Search, z: Array) -> float:
    aim, path = search.task.aim, search.path
    if not isinstance(aim, Reach):
        return np.inf
    pose = path_lift(search.task.connection, path.basis, search.coefficients(z)).pose
    return float(np.linalg.norm(aim.missed(pose)[0]))


def _plan(
    system: System,
    connection: Connection,
    gait: Gait,
    n: int,
    turn: Array,
    bounds: Limits,
    duration: float | None,
) -> TurnPlan:
    """Return the plan of n cycles; the phase by samples of its own judges it.  Raises Lost."""
    once = phase(connection, gait, tolerance=1e-13)
    group, whole = system.group, reach(system.group, turn)
    end = once.cycles(n)
    if group.turns == 1:  # whole turns count
        end = np.append(end[:-1], n * once.pose[-1])
    remaining = float(np.linalg.norm(whole.missed(end)[0]))
    if not remaining <= n * _LEFT:
        raise Lost(f"the loop leaves {remaining:.1e} rad of the target")
    peaks = peaks_of(connection, gait, n)
    room = peaks.needed(bounds)
    if duration is None:
        seconds = max(_SECONDS * n, room)
    else:
        seconds = positive(duration, "duration")
        if seconds < room:
            raise InputError(f"speeds and torques need {room:.3g} s, got duration {seconds:g}")
    own = margins(connection, gait, _of_shape(bounds))
    return TurnPlan(
        system=system, aim=whole, gait=gait.lasting(seconds / n), cycles=n, duration=seconds,
        phase=once, remaining=remaining, margins=own | peaks.margins(bounds, seconds),
    )  # fmt: skip


def _of_shape(limits: Limits) -> Limits:
    """Return the limits of joints alone: speeds and torques decide how long it takes."""
    free = np.full(len(limits.speed), np.inf)
    return Limits(limits.shape, free, free.copy())
