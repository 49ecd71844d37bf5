"""Times at which conditions on time change, found by sampling the forces' conditions.

This search is independent of the search for the stops of integrators. It samples all conditions
densely and bisects between samples that differ, so it can miss a pulse that is shorter than the
sample spacing. Such a pulse is detected if the motion stops at one of its ends, because the middle
of each span is sampled, too.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from ..common.arrays import Array
from ..forces.force_model import ForceModel

_SAMPLES = 1 << 14
_RESOLUTION = 1e-14  # length at which bisection ends, as a fraction of the duration


def condition_times(forces: ForceModel, stops: Array, numbers: Array) -> Array:
    """Return the sorted times before the last stop at which a condition on time changes.

    Args:
        forces: The forces.
        stops: Sorted times at which the motion stops, its end included, (S,) [s].
        numbers: Force parameters, (p,).
    Returns:
        The times, (K,) [s].
    """
    conditions = forces.switching.conditions
    if conditions is None:
        return np.empty(0)
    end = float(stops[-1])
    span_ends = np.concatenate([[0.0], stops])
    middles = 0.5 * (span_ends[1:] + span_ends[:-1])
    times = np.union1d(np.linspace(0.0, end, _SAMPLES), middles)
    values = _values(forces, conditions, times, numbers)
    changes = np.flatnonzero((values[1:] != values[:-1]).any(axis=1))
    a, b, at_a, at_b = times[changes], times[changes + 1], values[changes], values[changes + 1]
    while a.size and (b - a).max() > _RESOLUTION * end:
        middle = 0.5 * (a + b)
        at = _values(forces, conditions, middle, numbers)
        left, right = (at != at_a).any(axis=1), (at != at_b).any(axis=1)
        a, b = np.append(a[left], middle[right]), np.append(middle[left], b[right])
        at_a, at_b = (
            np.concatenate(rows) for rows in ((at_a[left], at[right]), (at[left], at_b[right]))
        )
    return np.unique(b)


def _values(forces: ForceModel, conditions: ca.Function, times: Array, numbers: Array) -> Array:
    """Return the values of all conditions, (T, C), at times (T,)."""
    mapped, rows = conditions.map(len(times)), np.repeat(numbers[None], len(times), axis=0)
    forces.set_span(rows, times)
    values = mapped(times[None], rows.T)
    return np.asarray(values.T)
