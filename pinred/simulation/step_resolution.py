"""Whether the steps of a run resolve its forces: functions of time, and narrow ranges of the shape.

Steps are not longer than the panels of `step_limits`. Methods of high order need no more, but the
error estimates of others may fail even so. The dense output of steps that are longer than half of
their limits is therefore put into the equations of motion: the difference between the change of
the state over a step and the integral of its rates, by a quadrature that resolves all functions, is
the defect of the step. If the sum of the defects exceeds the tolerance, the run is repeated with
shorter steps. Scenes without functions of time cost nothing.

Step control sees the forces at the stages of steps only. A force that acts in a narrow range of the
shape can lie between them. If the user asks for this check, the defect of the dense output,
ẏ − f(y), is evaluated at a random time in each of many equal spans of the run. A defect far above
the tolerance reveals a force that the step has skipped. The run is then repeated with a stop at the
worst time of each such step.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple, TypeVar

import numpy as np

from ..common.arrays import Array
from ..common.errors import InputError, IntegrationError
from ..integrators.methods import DOP853, DOP853_LEAST, ErrorControl
from ..scene.scene import Engine
from ..system.coordinates import Indices
from .longest_steps import Limited, StepLimits, step_limits
from .plan import Plan
from .reduced_flow import ReducedFlow, Segment
from .trajectory import Cost, Trajectory

_SHOWN = 5  # largest number of times in a notice
# Change of states between two runs that is an error, in tolerances.
_CHANGED = 100.0
_COMPARED = 16  # number of times at which two runs are compared
_DEFECT = 50.0  # largest sum of the defects of a run that resolves all functions, in tolerances
_NODES = 10  # number of nodes of the quadrature over a part of a step
_TOGETHER = 1 << 10  # number of parts of steps that are evaluated together
_CHECKED = 0.5  # length of the shortest steps that are checked, relative to the limits
# Lengths of steps in successive runs, relative to the limits.  The error estimate of a step in the
# flank of a pulse may fail although the step sees the whole function.
SHARES = (1.0, 0.4)
# Length of the longest steps in the first run, at least, relative to the panels.  Limits of methods
# of low order are shorter, but few functions need them.
_FIRST = 0.4


Result = TypeVar("Result")


class Steps(NamedTuple):
    """Successive steps between two stops of a run.

    Attributes:
        ends: Ends of the steps, with the start of the first, (K + 1,) [s].
        at: Dense output: function from times (T,) to reduced states (T, k).
        rates: Function from times (T,) and reduced states (T, k) to rates, (T, k).
    """

    ends: Array
    at: Callable[[Array], Array]
    rates: Callable[[Array, Array], Array]


def resolved_runs(
    limits: StepLimits,
    tolerance: tuple[float, float],
    run: Callable[[Limited], Result],
    steps_of: Callable[[Result], Iterable[Steps]],
) -> list[Result]:
    """Integrate with limited steps, and again with shorter ones if functions are not resolved.

    Args:
        limits: Limits of the steps.
        tolerance: Relative and absolute tolerance of the steps.
        run: Function that integrates with a longest step and stops.
        steps_of: Function from a run to its steps.
    Returns:
        All runs. The last one is the result.
    """
    runs: list[Result] = []
    for share in sorted({max(1.0, _FIRST / limits.share), *SHARES}, reverse=True):
        runs.append(run(limits.shorter(share).cheapest))
        # Methods of high order integrate functions on panels exactly.
        if limits.share == 1.0 or not is_unresolved(limits, steps_of(runs[-1]), tolerance):
            break
    return runs


def resolve(plan: Plan, run: Callable[[Plan], Trajectory], engine: Engine) -> Trajectory:
    """Return a trajectory whose steps resolve all functions of time in its forces.

    Args:
        plan: The plan.
        run: Function that integrates a plan.
        engine: The engine that integrates.
    Returns:
        The trajectory. A notice states functions that are not resolved.
    """
    assert plan.forces is not None
    compiled, tolerance = engine == "compiled", tolerance_of(plan, engine)
    arguments = plan.forces, plan.scene.end, plan.numbers, tolerance[0]
    limits = step_limits(*arguments, order_of(plan) if compiled else DOP853.order)
    limited = plan.limited(*limits.cheapest)
    if compiled and limited.method.name != plan.method.name:
        # The choice of the method takes stops into account.
        limits = step_limits(*arguments, order_of(limited))

    def steps_of(trajectory: Trajectory) -> Iterator[Steps]:
        return _steps_of(limits, trajectory)

    runs = resolved_runs(limits, tolerance, lambda each: run(plan.limited(*each)), steps_of)
    last, notices = runs[-1], runs[-1].run.notices
    if limits.unresolved.size:
        notices += (describe_unresolved(plan, limits.unresolved),)
    elif len(runs) == 1:
        return last
    last.run = replace(cost_of_all([each.run for each in runs]), notices=notices)
    return last


def _steps_of(limits: StepLimits, trajectory: Trajectory) -> Iterator[Steps]:
    """Yield the steps between stops, of spans that contain steps to be checked."""
    motion = trajectory.motion
    chosen: Iterable[int] = range(len(motion.segments))
    divisions, remainder = divmod(len(motion.knots) - 1, max(1, motion.steps))
    if divisions and not remainder:  # Each step has the same number of parts.
        chosen = steps_to_check(limits, motion.knots[::divisions], motion.segments.ends)
    for k in chosen:
        segment = motion.segments[k]
        knots = segment.knots
        divisions = -(-(len(knots) - 1) // max(1, segment.steps))  # of each step, rounded up
        ends = np.append(knots[:-1:divisions], knots[-1])
        yield Steps(ends, segment.at, partial(_rates, motion.flow_of(k), segment.parameters))


def _rates(flow: ReducedFlow, parameters: Array, t: Array, y: Array) -> Array:
    return flow.rates(t, y, parameters)


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
    if y.shape != other.shape:  # the modes at joint stops are others
        return True
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
    limits: StepLimits, steps: Iterable[Steps], tolerance: tuple[float, float]
) -> bool:
    """Return whether a step misses a part of a function of time.

    Args:
        limits: Limits of the steps.
        steps: Steps of the run, at least in the spans of `steps_to_check`.
        tolerance: Relative and absolute tolerance of the steps.
    """
    error: Array | float = 0.0
    size: Array | float = 0.0  # largest absolute value of each entry of the state so far
    for steps_of_span in steps:
        starts, lengths = steps_of_span.ends[:-1], np.diff(steps_of_span.ends)
        allowed = limits.within(starts, steps_of_span.ends[1:])
        long = lengths > _CHECKED * allowed
        if not long.any():
            continue
        counts = np.ceil(limits.share * lengths[long] / allowed[long]).astype(int)
        pieces = np.array_split(np.arange(len(counts)), -(-counts.sum() // _TOGETHER))
        for k in pieces:
            defects, sizes = _defects(steps_of_span, starts[long][k], lengths[long][k], counts[k])
            errors = error + np.cumsum(defects, axis=0)
            sizes = np.maximum.accumulate(np.maximum(sizes, size))
            if not (np.abs(errors) <= _DEFECT * (tolerance[1] + tolerance[0] * sizes)).all():
                return True
            error, size = errors[-1], sizes[-1]
    return False


def _defects(steps: Steps, starts: Array, lengths: Array, counts: Indices) -> tuple[Array, Array]:
    """Return the defects of K steps, and the absolute values of their states, (K, k) each.

    Args:
        steps: The steps of which these are some.
        starts: Starts of the steps, (K,) [s].
        lengths: Lengths of the steps, (K,) [s].
        counts: Numbers of equal parts that resolve all functions of time, (K,).
    """
    step, first = np.repeat(np.arange(len(counts)), counts), np.cumsum(counts) - counts
    part_index = np.arange(len(step)) - first[step]
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    half = 0.5 * (lengths / counts)[step]
    times = starts[step, None] + half[:, None] * (2 * part_index[:, None] + 1.0 + nodes)
    y = steps.at(np.concatenate([times.ravel(), starts, starts + lengths]))  # in one call: faster
    inside, before, after = np.split(y, [times.size, times.size + len(starts)])
    slopes = steps.rates(times.ravel(), inside).reshape(*times.shape, -1)
    changes = np.add.reduceat(half[:, None] * np.einsum("n,pnk->pk", weights, slopes), first)
    return after - before - changes, np.maximum(np.abs(before), np.abs(after))


_SAMPLES = 1000  # number of spans of a run with one sample each
_ALARM = 1e4  # smallest defect of a step that skips a force, in tolerances
_RERUNS = 3  # largest number of further runs
_DEGREE = 7  # degree of the polynomials through the dense output of a step
_SEED = 0  # seed of the sample times


@dataclass(frozen=True)
class _Worst:
    """The samples with the largest defects of steps with an alarm.

    Attributes:
        times: Times of these samples, (S,) [s].
        defects: Their defects, (S,), in tolerances.
    """

    times: Array
    defects: Array


def check_has_step_control(plan: Plan) -> None:
    """Raise InputError if the compiled engine runs a plan with a method of equal steps."""
    method = plan.method
    if not isinstance(method, ErrorControl):
        raise InputError(
            f"check: expected a method with step control, got {method}, whose defects are not "
            "related to a tolerance. Use DOP853, or omit check"
        )


def resolve_steps(
    plan: Plan, trajectory: Trajectory, run: Callable[[Plan], Trajectory]
) -> Trajectory:
    """Return a trajectory without defects far above its tolerance, with more stops if necessary.

    Args:
        plan: The plan of the trajectory.
        trajectory: The trajectory.
        run: Function that integrates a plan.
    Returns:
        The trajectory.
    Raises:
        IntegrationError: Defects remain after three further runs, and the last of them has changed
            the motion.
    """
    runs = [trajectory]
    if not plan.scene.bounds:  # segments of motions with joint stops end at impacts
        plan = plan.limited(np.inf, trajectory.motion.segments.ends[:-1])
    while (worst := find_defects(plan, runs[-1])).times.size and len(runs) <= _RERUNS:
        plan = plan.limited(np.inf, worst.times)
        runs.append(run(plan))
    last = runs[-1]
    # A large defect alone may be an error of the dense output, which does not enter the next step.
    if worst.times.size and differ(runs[-2], last):
        raise IntegrationError(_describe(last, worst))
    if len(runs) > 1:
        last.run = cost_of_all([repeated.run for repeated in runs])
    return last


def _describe(trajectory: Trajectory, worst: _Worst) -> str:
    k = int(np.argmax(worst.defects))
    time = float(worst.times[k])
    shape = trajectory.motion.states(worst.times[k : k + 1]).x[0]
    return (
        f"the steps of '{trajectory.system.name}' do not resolve a force near t = {time:g} s, "
        f"shape x = {shape}: the rate of the motion is wrong by {worst.defects[k]:.1e} tolerances, "
        f"also after {_RERUNS} further runs with stops there. Limit the steps with max_step"
    )


def find_defects(plan: Plan, trajectory: Trajectory) -> _Worst:
    """Return the worst sample of each step whose defect h |ẏ − f(y)| is far above the tolerance.

    Args:
        plan: The plan of the trajectory.
        trajectory: The trajectory.
    Returns:
        One sample for each of these steps, in order of time.
    """
    motion, tolerance = trajectory.motion, tolerance_of(plan, trajectory.run.engine)
    if not motion.flow.y0.size:
        return _Worst(np.empty(0), np.empty(0))
    samples = _sample_times(trajectory.scene.end)
    ends = np.append(0.0, motion.segments.ends)
    first = np.searchsorted(samples, ends)
    samples_of_segments = [
        _worst_of(motion.flow_of(k), segment, samples[first[k] : first[k + 1]], tolerance)
        for k, segment in enumerate(motion.segments)
        if first[k] < first[k + 1]
    ]
    times, defects = (np.concatenate(columns) for columns in zip(*samples_of_segments, strict=True))
    return _Worst(times, defects)


def _sample_times(end: float) -> Array:
    """Return a random time in each of equal spans, (_SAMPLES,) sorted [s]."""
    fractions = np.random.default_rng(_SEED).random(_SAMPLES)
    return np.asarray((np.arange(_SAMPLES) + fractions) * (end / _SAMPLES))


def _worst_of(
    flow: ReducedFlow, segment: Segment, times: Array, tolerance: tuple[float, float]
) -> tuple[Array, Array]:
    """Return times and defects of the worst samples of steps with an alarm in one segment."""
    knots = segment.knots
    step = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, len(knots) - 2)
    start, length = knots[step], np.diff(knots)[step]
    used, index = np.unique(step, return_inverse=True)
    coefficients = _fit(segment, knots[used], knots[used + 1])
    u = 2.0 * (times - start) / length - 1.0
    y = np.einsum("sd,sdn->sn", np.vander(u, _DEGREE + 1, increasing=True), coefficients[index])
    slopes = np.einsum("sd,sdn->sn", _powers_of_derivative(u), coefficients[index])
    rates = flow.rates(times, y, segment.parameters)
    rtol, atol = tolerance
    # 2 (dy/du) is h dy/dt.
    errors = np.abs(2.0 * slopes - length[:, None] * rates) / (atol + rtol * np.abs(y))
    defects = np.where(np.isnan(errors), np.inf, errors).max(axis=1)
    order = np.lexsort((-defects, step))
    worst = order[np.append(True, np.diff(step[order]) > 0)]
    worst = worst[defects[worst] > _ALARM]
    return times[worst], defects[worst]


def _fit(segment: Segment, starts: Array, ends: Array) -> Array:
    """Return coefficients of polynomials in u, from −1 to 1 over a step, (K, d + 1, n)."""
    count = _DEGREE + 1
    nodes = np.cos(np.pi * (np.arange(count) + 0.5) / count)
    times = starts[:, None] + (ends - starts)[:, None] * 0.5 * (1.0 + nodes)
    values = segment.at(times.ravel()).reshape(len(starts), count, -1)
    inverse = np.linalg.inv(np.vander(nodes, count, increasing=True))
    return np.asarray(np.einsum("dc,kcn->kdn", inverse, values))


def _powers_of_derivative(u: Array) -> Array:
    """Return the derivatives of 1, u, u², … at points (S,), (S, d + 1)."""
    powers = np.vander(u, _DEGREE, increasing=True) * np.arange(1, _DEGREE + 1)
    return np.hstack([np.zeros((len(u), 1)), powers])
