"""Whether the steps of a run resolve the functions of time in its forces.

Step control sees a force at the stages of its steps only, so it can skip a short bump. After a run,
each function of time is evaluated on a grid, and compared with the polynomial through its values at
the stages of each step. Where they differ, the run needs another stop. Scenes without functions of
time cost nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ..common.arrays import Array, read_only
from ..forces.force_model import ForceModel
from ..forces.switch_times import ROUND_OFF, time_within
from ..integrators.methods import DOP853, Method
from .compiled.integrator import divisions_of
from .motion import Motion
from .plan import Plan
from .time_table import (
    MISSED,
    SPARSE,
    TIMES,
    fit_of,
    resolved_limit,
    stops_at,
    time_table,
    worst_indices,
)
from .trajectory import Cost, Trajectory

_SHOWN = 5  # largest number of times in a notice
RERUNS = 2  # largest number of further runs
# Change of states between two runs that is an error, in tolerances.
_CHANGED = 100.0
_COMPARED = 16  # number of times at which two runs are compared
_COUNTS = 2 ** np.arange(11)  # numbers of equal steps on which functions are compared
_PER_STEP = 4  # distances of grid times in the shortest of these steps, at least
_SMOOTH = 0.1  # largest difference of smooth functions, relative to the largest that is resolved


def resolve(plan: Plan, trajectory: Trajectory, run: Callable[[Plan], Trajectory]) -> Trajectory:
    """Return a trajectory that resolves all functions of time, with more stops if necessary.

    Args:
        plan: The plan of the trajectory.
        trajectory: The trajectory.
        run: Function that integrates a plan.
    Returns:
        The trajectory. If functions are still not resolved after two more runs, and the last run
        has changed the motion, a notice states it.
    """
    runs = [trajectory]
    while (missed := _unresolved(plan, runs[-1])).size and len(runs) <= RERUNS:
        plan = with_stops(plan, missed)
        runs.append(run(plan))
    if len(runs) == 1:
        return trajectory
    last, notices = runs[-1], runs[-1].run.notices
    if missed.size and differ(runs[-2], last):
        notices += (describe_unresolved(plan, missed),)
    last.run = replace(cost_of_all([r.run for r in runs]), notices=notices)
    return last


def describe_unresolved(plan: Plan, times: Array) -> str:
    """Return a sentence on functions of time that are not resolved at times (U,) [s]."""
    shown = ", ".join(f"{t:g}" for t in times[:_SHOWN].tolist())
    return (
        f"forces: a function of time of '{plan.system.name}' changes faster than the steps "
        f"near t = {shown} s, so the motion may be wrong. Limit the steps with max_step, or "
        "state the times as breaks of a table"
    )


def cost_of_all(runs: Sequence[Cost]) -> Cost:
    """Return the cost of the last of several runs, with the evaluations and times of all."""
    notices = dict.fromkeys(notice for run in runs for notice in run.notices)
    return replace(
        runs[-1],
        evaluations=sum(run.evaluations for run in runs),
        wall=sum(run.wall for run in runs),
        notices=tuple(notices),
    )


def _unresolved(plan: Plan, trajectory: Trajectory) -> Array:
    if trajectory.run.engine == "compiled":
        return find_unresolved(plan, trajectory.motion, type(plan.method), divisions_of(plan))
    return find_unresolved(plan, trajectory.motion, DOP853)


def differ(first: Trajectory, second: Trajectory) -> bool:
    """Return whether two motions of a scene differ by more than their tolerance explains."""
    end = min(first.scene.end, second.scene.end)
    times = np.linspace(0.0, end, _COMPARED + 1)[1:]
    y, other = first.motion.reduced(times), second.motion.reduced(times)
    return states_differ(first.plan, y, other)


def states_differ(plan: Plan, y: Array, other: Array) -> bool:
    """Return whether reduced states (T, k) differ by more than the tolerance of a plan explains."""
    rtol, atol = plan.scene.rtol, plan.scene.atol
    scale = atol + rtol * np.maximum(1.0, np.abs(y).max(axis=1, initial=0.0))
    return not (np.abs(y - other).max(axis=1, initial=0.0) <= _CHANGED * scale).all()


def find_unresolved(plan: Plan, motion: Motion, method: type[Method], divisions: int = 1) -> Array:
    """Return the times at which functions of time are not resolved by the steps of a motion.

    Args:
        plan: The plan of the scene.
        motion: The motion.
        method: Method of the steps.
        divisions: Number of parts into which `motion.knots` divide each step.
    Returns:
        The time of the largest difference in each step with a difference, (U,) [s].
    """
    if plan.forces is None:
        return np.empty(0)
    knots = _step_ends(motion, divisions)
    return unresolved_times(plan, plan.forces, plan.forces.numbers, knots, method)


def unresolved_times(
    plan: Plan, forces: ForceModel, numbers: Array, knots: Array, method: type[Method]
) -> Array:
    """Return the times at which functions of time are not resolved by steps.

    Args:
        plan: The plan of the scene.
        forces: Its forces.
        numbers: Force parameters of the run, (p,).
        knots: Ends of the steps, with the start of the run, (K + 1,) [s].
        method: Method of the steps.
    Returns:
        The time of the largest difference in each step with a difference, (U,) [s].
    """
    nodes, fit = fit_of(method)
    if not nodes.size:
        return np.empty(0)
    table = time_table(forces, plan.scene.end, numbers)
    worst = worst_indices(table, knots, nodes, fit, resolved_limit(plan, nodes))
    return stops_at(table, worst[worst >= 0], nodes)


def stops_for_any_steps(
    plan: Plan, forces: ForceModel, numbers: Array, method: type[Method]
) -> Array:
    """Return stops with which steps of any length see all short changes of functions of time.

    The functions are compared on equal steps of many lengths. Steps of a length can skip a change
    only if the functions are smooth before it on this length. A stop is placed in each such change.

    Args:
        plan: The plan of the scene.
        forces: Its forces.
        numbers: Force parameters of the run, (p,).
        method: Method of the steps.
    Returns:
        Stops, (U,) sorted [s]. They depend on the functions only, not on the motion.
    """
    nodes, fit = fit_of(method)
    if not nodes.size or _is_smooth(forces, plan.scene.end, numbers):
        return np.empty(0)
    table, limit = time_table(forces, plan.scene.end, numbers), resolved_limit(plan, nodes)
    found = [np.empty(0, dtype=np.int64)]
    finest = len(table.chosen) and int(np.diff(table.chosen).clip(1).min())
    for count in _COUNTS[TIMES / (_PER_STEP * max(finest, 1)) >= _COUNTS]:
        for offset in (0.0, 0.5):  # a change can lie across the end of a step
            grid = plan.scene.end / count * (np.arange(count) + offset)
            knots = np.union1d(grid, np.append(table.starts, table.ends))
            worst = worst_indices(table, knots, nodes, fit, limit)
            if (worst >= 0).any():
                smooth = worst_indices(table, knots, nodes, fit, _SMOOTH * limit) < 0
                # No step precedes the first one, so there the change has to end again.
                begins = np.append(smooth[1:2], smooth[:-1]) if count > 1 else np.array([True])
                found.append(worst[(worst >= 0) & begins[: len(worst)]])
    return stops_at(table, np.unique(np.concatenate(found)), nodes)


def _is_smooth(forces: ForceModel, end: float, numbers: Array) -> bool:
    """Return whether functions of time are almost linear between distant times, (p,) numbers."""
    if forces.switching.breaks(end, numbers).size:
        return False
    times = np.linspace(0.0, end, TIMES + 1)
    within = float(time_within(0.0, end))
    values = forces.time_functions(times, numbers, forces.within, within)
    ends, parts = values[:, ::SPARSE], np.arange(SPARSE) / SPARSE
    inside = values[:, :-1].reshape(len(values), -1, SPARSE)
    linear = ends[:, :-1, None] + np.diff(ends)[:, :, None] * parts
    off = np.abs(inside - linear).max(axis=(1, 2))
    return bool((off <= MISSED * np.ptp(values, axis=1)).all())


def with_stops(plan: Plan, times: Array) -> Plan:
    """Return a plan that also stops at given times, (U,) [s]."""
    return replace(plan, stops=joined_stops(plan.stops, times))


def joined_stops(stops: Array, times: Array) -> Array:
    """Return the union of stops, (S,) with the end as last, and times, (U,); read-only [s]."""
    union = np.union1d(stops, times)
    distinct = np.append(np.diff(union) > ROUND_OFF * stops[-1], True)
    return read_only(union[distinct])


def _step_ends(motion: Motion, divisions: int) -> Array:
    """Return the times of the ends of steps, with the start of the run, (K + 1,) [s]."""
    segments = motion.segments
    knots = segments[0].knots if len(segments) == 1 else motion.knots
    ends = np.array(knots[::divisions])
    return ends if ends[-1] == knots[-1] else np.append(ends, knots[-1])
