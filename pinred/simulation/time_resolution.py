"""Whether the steps of a run resolve the functions of time in its forces.

Step control sees a force at the stages of its steps only, so it can skip a short bump. After a run,
each function of time is evaluated on a grid, and compared with the polynomial through its values at
the stages of each step. Where they differ, the run needs another stop. Scenes without functions of
time cost nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from ..common.arrays import Array, read_only
from ..common.memo import once
from ..forces.force_model import ForceModel
from ..forces.switch_times import ROUND_OFF, time_within
from ..integrators.methods import DOP853, Method
from ..integrators.stepping.compiling import compiled
from ..system.coordinates import Indices
from .compiled.integrator import divisions_of
from .motion import Motion
from .plan import Plan
from .trajectory import Cost, Trajectory

_TIMES = 8000  # number of times in the table of a run
_FEWEST = 16  # least number of times in a span of the table
_DEGREE = 7  # largest degree of the polynomials
# Largest difference that counts as resolved, as a fraction of the function's range, at rtol 1e-6.
# It is proportional to the third root of rtol, up to the largest value.
_MISSED, _MOST_MISSED = 0.02, 0.2
_ROUND_OFF = 1e-9  # the same as a fraction of the function's largest absolute value
_SHOWN = 5  # largest number of times in a notice
_RERUNS = 2  # largest number of further runs
# Change of states between two runs that is an error, in tolerances.
_CHANGED = 100.0
_COMPARED = 16  # number of times at which two runs are compared
_SPARSE = 32  # largest distance of grid times at which functions are compared, in grid times
_LINEAR = 1e-3  # largest deviation from linear interpolation between them, relative to the range
_RUNS = 16  # number of runs whose grid values are cached


@dataclass(frozen=True)
class _Table:
    """The functions of time of one run in spans between breaks, with equal distances in a span.

    Attributes:
        ends: End of each span, (S,) [s].
        starts: Start of each span, (S,) [s].
        gaps: Distance of the times of each span, (S,) [s].
        first: Index of the first time of each span, (S + 1,).
        values: Values of the functions divided by their ranges, (F, G).
        chosen: Indices of the times at which functions are compared, (C,).
        times: These times, (C,) [s].
    """

    ends: Array
    starts: Array
    gaps: Array
    first: Indices
    values: Array
    chosen: Indices
    times: Array


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
    while (missed := _unresolved(plan, runs[-1])).size and len(runs) <= _RERUNS:
        plan = with_stops(plan, missed)
        runs.append(run(plan))
    if len(runs) == 1:
        return trajectory
    last, notices = runs[-1], runs[-1].run.notices
    if missed.size and differ(runs[-2], last):
        times = ", ".join(f"{t:g}" for t in missed[:_SHOWN].tolist())
        notices += (
            f"forces: a function of time of '{plan.system.name}' changes faster than the steps "
            f"near t = {times} s, so the motion may be wrong. Limit the steps with max_step, or "
            "state the times as breaks of a table",
        )
    last.run = replace(cost_of_all([r.run for r in runs]), notices=notices)
    return last


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
    rtol, atol = first.scene.rtol, first.scene.atol
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
    forces, (nodes, fit) = plan.forces, _fit(method)
    if forces is None or not nodes.size:
        return np.empty(0)
    table = _table(forces, plan.scene.end)
    knots = _step_ends(motion, divisions)
    # Steps of collocation are long at any tolerance: their order is twice the number of stages.
    rtol = plan.scene.rtol if nodes[0] == 0.0 else max(plan.scene.rtol, 1e-6)
    missed = min(_MISSED * (rtol / 1e-6) ** (1.0 / 3.0), _MOST_MISSED)
    worst = np.empty(len(knots) - 1, dtype=np.int64)
    work = np.empty((len(table.values), fit.shape[1]))
    _find_worst(
        knots, nodes, fit, table.ends, table.starts, table.gaps, table.first, table.values,
        table.chosen, table.times, missed, work, worst,
    )  # fmt: skip
    return table.times[worst[worst >= 0]]


def with_stops(plan: Plan, times: Array) -> Plan:
    """Return a plan that also stops at given times, (U,) [s]."""
    stops = np.union1d(plan.stops, times)
    distinct = np.append(np.diff(stops) > ROUND_OFF * plan.scene.end, True)
    return replace(plan, stops=read_only(stops[distinct]))


def _step_ends(motion: Motion, divisions: int) -> Array:
    """Return the times of the ends of steps, with the start of the run, (K + 1,) [s]."""
    segments = motion.segments
    knots = segments[0].knots if len(segments) == 1 else motion.knots
    ends = np.array(knots[::divisions])
    return ends if ends[-1] == knots[-1] else np.append(ends, knots[-1])


@cache
def _fit(method: type[Method]) -> tuple[Array, Array]:
    """Return distinct stage times, (s,), and the matrix from values there to coefficients.

    The matrix (s, d) fits polynomials of u = 2 c − 1 to values in the sense of least squares.
    """
    nodes = np.unique(method.stage_times())
    if not nodes.size:
        return nodes, np.empty((0, 0))
    degree = min(_DEGREE, len(nodes) - 1)
    powers = np.vander(2.0 * nodes - 1.0, degree + 1, increasing=True)
    return nodes, np.ascontiguousarray(np.linalg.pinv(powers).T)


def _table(forces: ForceModel, end: float) -> _Table:
    """Return the table of the functions of time, cached."""
    functions = forces.time_functions
    known: dict[tuple[float, bytes], _Table] = once(functions, _Table, dict)
    key = end, forces.numbers.tobytes()
    table = known.get(key)
    if table is None:
        while len(known) >= _RUNS:
            known.pop(next(iter(known)), None)
        table = known[key] = _tabulate(forces, end)
    return table


def _tabulate(forces: ForceModel, end: float) -> _Table:
    breaks = forces.breaks(end)
    starts, ends = np.append(0.0, breaks), np.append(breaks, end)
    counts = np.maximum(np.ceil(_TIMES * (ends - starts) / end).astype(int) + 1, _FEWEST)
    gaps, first = (ends - starts) / (counts - 1), np.append(0, np.cumsum(counts))
    span = np.repeat(np.arange(len(counts)), counts)
    times = starts[span] + gaps[span] * (np.arange(len(span)) - first[span])
    within = time_within(starts, ends)[span]
    values = forces.time_functions(times, forces.numbers, forces.within, within)
    finite = np.where(np.isfinite(values), values, 0.0)
    sizes = np.maximum(np.ptp(finite, axis=1), _ROUND_OFF * np.abs(finite).max(axis=1))
    values /= (sizes + np.finfo(float).tiny)[:, None]
    chosen = _needed(values, first)
    return _Table(ends, starts, gaps, first, values, chosen, times[chosen])


def _needed(values: Array, first: Indices) -> Indices:
    """Return the indices of times between which all functions are almost linear.

    Args:
        values: Values of the functions divided by their ranges, (F, G).
        first: Index of the first time of each span, (S + 1,).
    Returns:
        Sorted indices. Other values differ by less than _LINEAR from linear interpolation.
    """
    everywhere = np.arange(values.shape[1])
    chosen = np.unique(np.concatenate([everywhere[::_SPARSE], first[:-1], first[1:] - 1]))
    while True:
        off = np.zeros(len(everywhere))
        for row in values:
            off = np.maximum(off, np.abs(row - np.interp(everywhere, chosen, row[chosen])))
        # Where a value is not a number, every time is kept.
        bad = np.maximum.reduceat(np.where(off <= _LINEAR, 0.0, 1.0), chosen[:-1]) > 0.0
        bad &= np.diff(chosen) > 1
        if not bad.any():
            return chosen
        chosen = np.union1d(chosen, ((chosen[:-1] + chosen[1:]) // 2)[bad])


@compiled
def _interpolate(row: Array, first: int, last: int, u: float) -> float:
    """Interpolate a row between indices first and last at index first + u, by a cubic."""
    i = min(max(int(u) - 1, 0), last - first - 3)
    s, i = u - i, first + i
    a, b, c = s - 1.0, s - 2.0, s - 3.0
    outer = s * a * b * row[i + 3] - a * b * c * row[i]
    inner = s * b * c * row[i + 1] - s * a * c * row[i + 2]
    value: float = outer / 6.0 + 0.5 * inner
    return value


@compiled
def _find_worst(
    knots: Array,
    nodes: Array,
    fit: Array,
    ends: Array,
    starts: Array,
    gaps: Array,
    first: Indices,
    values: Array,
    chosen: Indices,
    times: Array,
    missed: float,
    work: Array,
    worst: Indices,
) -> None:
    """Find the time in each step at which a function differs most from its polynomial.

    Args:
        knots: Ends of steps, with the start of the run, (K + 1,) [s].
        nodes: Distinct times of stages as fractions of a step, (s,).
        fit: Matrix from values at the nodes to coefficients of the polynomial, (s, d).
        ends: Field of the table, like the following ones up to `times`.
        starts: See _Table.
        gaps: See _Table.
        first: See _Table.
        values: See _Table.
        chosen: See _Table.
        times: See _Table.
        missed: Largest difference that counts as resolved, relative to the range.
        work: Coefficients of all functions in one step, (F, d); changed.
        worst: Index among `times`, (K,), −1 if the step resolves all functions; output.
    """
    j, span = 0, 0
    for k in range(worst.shape[0]):
        start, length = knots[k], knots[k + 1] - knots[k]
        while span + 1 < ends.shape[0] and ends[span] < start + 0.5 * length:
            span += 1
        for f in range(values.shape[0]):
            for i in range(fit.shape[1]):
                work[f, i] = 0.0
            for n in range(nodes.shape[0]):
                u = (start + nodes[n] * length - starts[span]) / gaps[span]
                value = _interpolate(values[f], first[span], first[span + 1] - 1, u)
                for i in range(fit.shape[1]):
                    work[f, i] += value * fit[n, i]
        worst[k] = -1
        most = missed
        while j < times.shape[0] and chosen[j] < first[span]:
            j += 1
        while j < times.shape[0] and chosen[j] < first[span + 1] and times[j] <= knots[k + 1]:
            u = 2.0 * (times[j] - start) / length - 1.0
            for f in range(values.shape[0]):
                polynomial = 0.0
                for i in range(fit.shape[1] - 1, -1, -1):
                    polynomial = polynomial * u + work[f, i]
                difference = abs(values[f, chosen[j]] - polynomial)
                if difference > most:
                    most = difference
                    worst[k] = j
            j += 1
