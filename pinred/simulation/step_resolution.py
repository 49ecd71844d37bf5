"""Whether the steps of a run resolve all forces, checked between their stages.

Step control sees the forces at the stages of steps only. A force that acts in a narrow range of the
shape can lie between them. The defect of the dense output, ẏ − f(y), is evaluated at a random time
in each of many equal spans of the run. A defect far above the tolerance reveals a force that the
step has skipped. The run is then repeated with a stop at the worst time of each such step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..common.arrays import Array
from ..common.errors import InputError, IntegrationError
from ..integrators.methods import ErrorControl
from .plan import Plan
from .reduced_flow import ReducedFlow, Segment
from .time_resolution import cost_of_all, differ, tolerance_of
from .trajectory import Trajectory

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
        last.run = cost_of_all([each.run for each in runs])
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
    times, defects = (np.concatenate(rows) for rows in zip(*samples_of_segments, strict=True))
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
    used, row = np.unique(step, return_inverse=True)
    coefficients = _fit(segment, knots[used], knots[used + 1])
    u = 2.0 * (times - start) / length - 1.0
    y = np.einsum("sd,sdn->sn", np.vander(u, _DEGREE + 1, increasing=True), coefficients[row])
    slopes = np.einsum("sd,sdn->sn", _powers_of_derivative(u), coefficients[row])
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
