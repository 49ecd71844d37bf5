"""Functions of time in forces on a fine grid, and their comparison with the stages of steps.

Between breaks, a function is compared with the polynomial through its values at the stages of each
step.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from ..common.arrays import Array
from ..common.memo import once
from ..forces.force_model import ForceModel
from ..forces.switch_times import time_within
from ..integrators.methods import Method
from ..integrators.stepping.compiling import compiled
from ..system.coordinates import Indices
from .plan import Plan

TIMES = 8000  # number of times in the table of a run
_FEWEST = 16  # least number of times in a span of the table
_DEGREE = 7  # largest degree of the polynomials
# Largest difference that counts as resolved, as a fraction of the function's range, at rtol 1e-6.
# It is proportional to the third root of rtol, up to the largest value.
MISSED, _MOST_MISSED = 0.02, 0.2
_ROUND_OFF = 1e-9  # the same as a fraction of the function's largest absolute value
SPARSE = 32  # largest distance of grid times at which functions are compared, in grid times
_LINEAR = 1e-3  # largest deviation from linear interpolation between them, relative to the range
# For Gauss methods, indices of stops relative to that of the largest difference.
_AROUND = np.array([-48, -32, -24, -16, -12, -8, -6, -4, -2, 0, 2, 4, 6, 8, 12, 16, 24, 32, 48])
_RUNS = 16  # number of runs whose grid values are cached


@dataclass(frozen=True)
class TimeTable:
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


def resolved_limit(plan: Plan, nodes: Array) -> float:
    """Return the largest difference that counts as resolved, relative to a function's range."""
    # Steps of collocation are long at any tolerance: their order is twice the number of stages.
    rtol = plan.scene.rtol if nodes[0] == 0.0 else max(plan.scene.rtol, 1e-6)
    return float(min(MISSED * (rtol / 1e-6) ** (1.0 / 3.0), _MOST_MISSED))


def worst_indices(
    table: TimeTable, knots: Array, nodes: Array, fit: Array, missed: float
) -> Indices:
    """Return the index of the largest difference in each step, (K,); −1 in resolved steps."""
    worst = np.empty(len(knots) - 1, dtype=np.int64)
    work = np.empty((len(table.values), fit.shape[1]))
    _find_worst(
        knots, nodes, fit, table.ends, table.starts, table.gaps, table.first, table.values,
        table.chosen, table.times, missed, work, worst,
    )  # fmt: skip
    return worst


def stops_at(table: TimeTable, found: Indices, nodes: Array) -> Array:
    """Return the stops for differences with given indices among the times of a table."""
    if nodes[0] > 0.0 and nodes[-1] < 1.0:  # no stage at the ends of a step sees a stop
        found = np.unique(np.clip(found[:, None] + _AROUND, 0, len(table.times) - 1))
    return table.times[found]


@cache
def fit_of(method: type[Method]) -> tuple[Array, Array]:
    """Return distinct stage times, (s,), and the matrix from values there to coefficients.

    The matrix (s, d) fits polynomials of u = 2 c − 1 to values in the sense of least squares.
    """
    nodes = np.unique(method.stage_times())
    if not nodes.size:
        return nodes, np.empty((0, 0))
    degree = min(_DEGREE, len(nodes) - 1)
    powers = np.vander(2.0 * nodes - 1.0, degree + 1, increasing=True)
    return nodes, np.ascontiguousarray(np.linalg.pinv(powers).T)


def time_table(forces: ForceModel, end: float, numbers: Array) -> TimeTable:
    """Return the table of the functions of time with force parameters (p,), cached."""
    functions = forces.time_functions
    tables: dict[tuple[float, bytes], TimeTable] = once(functions, TimeTable, dict)
    key = end, numbers[functions_depend_on(forces)].tobytes()
    table = tables.get(key)
    if table is None:
        while len(tables) >= _RUNS:
            tables.pop(next(iter(tables)), None)
        table = tables[key] = _tabulate(forces, end, numbers)
    return table


def functions_depend_on(forces: ForceModel) -> list[int]:
    """Return the indices of the numbers on which functions of time and their breaks depend."""
    within = range(forces.within.start, forces.within.stop)
    used = {*forces.time_functions.used, *forces.switching.used}
    return sorted(used.difference(within))


def _tabulate(forces: ForceModel, end: float, numbers: Array) -> TimeTable:
    breaks = forces.switching.breaks(end, numbers)
    starts, ends = np.append(0.0, breaks), np.append(breaks, end)
    counts = np.maximum(np.ceil(TIMES * (ends - starts) / end).astype(int) + 1, _FEWEST)
    gaps, first = (ends - starts) / (counts - 1), np.append(0, np.cumsum(counts))
    span = np.repeat(np.arange(len(counts)), counts)
    times = starts[span] + gaps[span] * (np.arange(len(span)) - first[span])
    within = time_within(starts, ends)[span]
    values = forces.time_functions(times, numbers, forces.within, within)
    finite = np.where(np.isfinite(values), values, 0.0)
    sizes = np.maximum(np.ptp(finite, axis=1), _ROUND_OFF * np.abs(finite).max(axis=1))
    values /= (sizes + np.finfo(float).tiny)[:, None]
    chosen = _needed(values, first)
    return TimeTable(ends, starts, gaps, first, values, chosen, times[chosen])


def _needed(values: Array, first: Indices) -> Indices:
    """Return the indices of times between which all functions are almost linear.

    Args:
        values: Values of the functions divided by their ranges, (F, G).
        first: Index of the first time of each span, (S + 1,).
    Returns:
        Sorted indices. Other values differ by less than _LINEAR from linear interpolation.
    """
    everywhere = np.arange(values.shape[1])
    chosen = np.unique(np.concatenate([everywhere[::SPARSE], first[:-1], first[1:] - 1]))
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
        starts: See TimeTable.
        gaps: See TimeTable.
        first: See TimeTable.
        values: See TimeTable.
        chosen: See TimeTable.
        times: See TimeTable.
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
