"""Whether the steps of a run resolve the functions of time in its forces.

Steps that are longer than the limits of `step_limits` may miss a part of a function. The dense
output of these steps is then put into the equations of motion: the difference between the change
of the state over a step and the integral of its rates, by a quadrature that resolves all functions,
is the defect of the step. If a defect exceeds the tolerance, the run is repeated with stops between
which no step is too long. Scenes without functions of time cost nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..common.arrays import Array
from ..integrators.methods import DOP853, DOP853_LEAST, ErrorControl
from ..system.coordinates import Indices
from .compiled.integrator import divisions_of
from .motion import Motion
from .plan import Plan
from .step_limits import StepLimits, step_limits
from .trajectory import Cost, Trajectory

_SHOWN = 5  # largest number of times in a notice
# Change of states between two runs that is an error, in tolerances.
_CHANGED = 100.0
_COMPARED = 16  # number of times at which two runs are compared
_DEFECT = 20.0  # largest defect of a step that resolves all functions, in tolerances
_NODES = 16  # number of nodes of the quadrature over a part of a step
_MOST_PARTS = 1 << 12  # largest number of these parts of all steps of a run
_CHECKED = 0.5  # length of the shortest steps that are checked, relative to the limits
# Lengths of steps in further runs, relative to the limits.  The error estimate of a step in the
# flank of a pulse may fail although the step sees the whole function.
SHARES = (1.0, 0.4)


class Steps(NamedTuple):
    """Successive steps between two stops of a run.

    Attributes:
        ends: Ends of the steps, with the start of the first, (K + 1,) [s].
        at: Dense output: function from times (T,) to reduced states (T, k).
        parameters: Parameters of the vector field, (p,).
    """

    ends: Array
    at: Callable[[Array], Array]
    parameters: Array


Rates = Callable[[Array, Array, Array], Array]


def resolve(plan: Plan, trajectory: Trajectory, run: Callable[[Plan], Trajectory]) -> Trajectory:
    """Return a trajectory that resolves all functions of time, with more stops if necessary.

    Args:
        plan: The plan of the trajectory.
        trajectory: The trajectory.
        run: Function that integrates a plan.
    Returns:
        The trajectory. A notice states functions that are still not resolved.
    """
    if plan.forces is None:
        return trajectory
    engine, runs = trajectory.run.engine, [trajectory]
    limited = plan
    tolerance = tolerance_of(plan, engine)
    arguments = plan.forces, plan.scene.end, plan.numbers, tolerance[0]
    limits = step_limits(*arguments, order_of(plan) if engine == "compiled" else DOP853.order)
    for share in SHARES:
        motion = runs[-1].motion
        divisions = divisions_of(limited) if engine == "compiled" else 1
        steps = steps_to_check(limits, motion.knots[::divisions], motion.segments.ends)

        def steps_of(k: int, motion: Motion = motion, divisions: int = divisions) -> Steps:
            segment = motion.segments[k]
            return Steps(segment.knots[::divisions], segment.at, segment.parameters)

        if not is_unresolved(limits, map(steps_of, steps), motion.flow.rates, tolerance):
            break
        limited = plan.limited(*limits.shorter(share).cheapest())
        if engine == "compiled" and limited.method.name != plan.method.name:
            # The choice of the method takes stops into account.
            limits = step_limits(*arguments, order_of(limited))
            limited = plan.limited(*limits.shorter(share).cheapest())
        runs.append(run(limited))
    last, notices = runs[-1], runs[-1].run.notices
    if limits.unresolved.size:
        notices += (describe_unresolved(plan, limits.unresolved),)
    elif len(runs) == 1:
        return trajectory
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


def differ(first: Trajectory, second: Trajectory) -> bool:
    """Return whether two motions of a scene differ by more than their tolerance explains."""
    end = min(first.scene.end, second.scene.end)
    times = np.linspace(0.0, end, _COMPARED + 1)[1:]
    y, other = first.motion.reduced(times), second.motion.reduced(times)
    scale = first.plan.scene.atol + first.plan.scene.rtol * np.maximum(
        1.0, np.abs(y).max(axis=1, initial=0.0)
    )
    return not (np.abs(y - other).max(axis=1, initial=0.0) <= _CHANGED * scale).all()


def tolerance_of(plan: Plan, engine: str) -> tuple[float, float]:
    """Return the relative and absolute tolerance of the steps of a run."""
    method = plan.method
    if engine == "compiled" and isinstance(method, ErrorControl):
        return method.rtol, method.atol
    rtol, atol = plan.scene.tolerance
    return max(rtol, DOP853_LEAST), atol


def order_of(plan: Plan) -> int:
    """Return the order of the solution whose error controls the steps of a compiled run."""
    method = plan.method
    return method.controlled_order if isinstance(method, ErrorControl) else method.order


def steps_to_check(limits: StepLimits, ends: Array, stops: Array) -> list[int]:
    """Return the indices of the spans between stops that contain steps to be checked.

    Args:
        limits: Limits of the steps.
        ends: Ends of all steps, with the start of the first, (K + 1,) [s].
        stops: Ends of the spans, (S,) [s].
    Returns:
        The indices in increasing order.
    """
    long = np.diff(ends) > _CHECKED * limits.within(ends[:-1], ends[1:])
    spans = np.searchsorted(stops, ends[1:][long], side="left")
    indices: list[int] = np.unique(np.minimum(spans, len(stops) - 1)).tolist()
    return indices


def is_unresolved(
    limits: StepLimits, steps: Iterable[Steps], rates: Rates, tolerance: tuple[float, float]
) -> bool:
    """Return whether a step misses a part of a function of time.

    Args:
        limits: Limits of the steps.
        steps: Steps of the run, at least in the spans of `steps_to_check`.
        rates: Function from times (T,), reduced states (T, k) and parameters to rates, (T, k).
        tolerance: Relative and absolute tolerance of the steps.
    """
    for each in steps:
        starts, lengths = each.ends[:-1], np.diff(each.ends)
        allowed = limits.within(starts, each.ends[1:])
        long = lengths > _CHECKED * allowed
        if not long.any():
            continue
        counts = np.ceil(lengths[long] / allowed[long])
        if not counts.sum() <= _MOST_PARTS:
            return True
        defects = _defects(each, starts[long], lengths[long], counts.astype(int), rates, tolerance)
        if not (defects <= _DEFECT).all():
            return True
    return False


def _defects(
    steps: Steps,
    starts: Array,
    lengths: Array,
    counts: Indices,
    rates: Rates,
    tolerance: tuple[float, float],
) -> Array:
    """Return the defects of K steps, in tolerances, (K,).

    Args:
        steps: The steps of which these are some.
        starts: Starts of the steps, (K,) [s].
        lengths: Lengths of the steps, (K,) [s].
        counts: Numbers of equal parts that resolve all functions of time, (K,).
        rates: See `is_unresolved`.
        tolerance: See `is_unresolved`.
    """
    step, first = np.repeat(np.arange(len(counts)), counts), np.cumsum(counts) - counts
    part = np.arange(len(step)) - first[step]
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    half = 0.5 * (lengths / counts)[step]
    times = starts[step, None] + half[:, None] * (2 * part[:, None] + 1.0 + nodes)
    y = steps.at(times.ravel())
    slopes = rates(times.ravel(), y, steps.parameters).reshape(*times.shape, -1)
    changes = np.add.reduceat(half[:, None] * np.einsum("n,pnk->pk", weights, slopes), first)
    before, after = steps.at(starts), steps.at(starts + lengths)
    rtol, atol = tolerance
    errors = np.abs(after - before - changes) / (atol + rtol * np.abs(after))
    return np.asarray(np.where(np.isnan(errors), np.inf, errors).max(axis=1, initial=0.0))
