"""Long runs with equal steps, which store few states: integration of a plan, and its segments."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...common.arrays import Array, read_only
from ...common.errors import IntegrationError
from ...forces.switch_times import time_within
from ...integrators.methods import EqualSteps
from ...integrators.methods.method import registers_of
from ...integrators.thinned_run import ThinnedIntegration, ThinnedSolution
from ..checkpoint import Part, RunRecord
from ..plan import Plan
from ..reduced_flow import Segment, Segments
from .compiled_flow import CompiledFlow
from .integrator import divisions_of, explained, refined, wild_steps

# Step ends are stored as long as they take fewer bytes.
STORED_BYTES = 1 << 23
FEW = 4  # Step ends are stored if there are fewer of them per report time.


def thinned(
    flow: CompiledFlow,
    plan: Plan,
    method: EqualSteps,
    progress: Callable[[float], None] | None,
    record: RunRecord | None = None,
) -> Callable[[], Segments] | None:
    """Return the function that integrates a flow and stores the states at report times only.

    Args:
        flow: The flow of the plan.
        plan: The plan.
        method: The method of the plan.
        progress: Called repeatedly with the completed fraction of the time, 0 to 1.
        record: Record of the run in a checkpoint, from which it continues; or None.
    Returns:
        The function; None for short runs, runs with many report times, and runs with events or
        controllers, see long_segments.py.
    """
    if plan.is_observed or not stores_few(flow, plan, method):
        return None
    return lambda: _integrate(flow, plan, method, progress, record)


def stores_few(flow: CompiledFlow, plan: Plan, method: EqualSteps) -> bool:
    """Return whether the step ends of a plan take much memory, and few times are reported."""
    steps = sum(registers_of(method, span.stop - span.start)["total"] for span in plan.spans)
    few_bytes = 8.0 * steps * (1 + flow.y0.size) <= STORED_BYTES
    return not few_bytes and steps >= FEW * len(plan.scene.report_times)


def wild_check(flow: CompiledFlow, plan: Plan) -> Callable[[Array, Array], None]:
    """Return a function that rejects joints that rotate several turns within a step.

    Its arguments are the times (2,) [s] of two step ends and the reduced states (2, k).
    """

    def look(times: Array, states: Array) -> None:
        if wild := wild_steps(flow.kernel, plan, states, times - times[0]):
            raise IntegrationError(wild)

    return look


def _integrate(
    flow: CompiledFlow,
    plan: Plan,
    method: EqualSteps,
    progress: Callable[[float], None] | None,
    record: RunRecord | None,
) -> ThinnedSegments:
    scene, kernel = plan.scene, flow.kernel
    y0 = flow.y0 if flow.y0.size else np.zeros(1)
    reported, solutions = np.empty((len(scene.report_times), len(y0))), []
    address, look = flow.address(method), wild_check(flow, plan)

    for span in plan.spans:
        length, start = span.stop - span.start, span.start
        params = flow.parameters_within(np.array([time_within(start, span.stop)]))[0]

        def done(part: float, start: float = start, length: float = length) -> None:
            if progress is not None:
                progress((start + part * length) / scene.end)

        integration = ThinnedIntegration(
            method, address, len(y0), length, kernel.layout.quaternions, kernel.canonical,
            flow.tangent,
        )  # fmt: skip
        times = read_only(np.append(span.times.clip(0.0, length), length))
        if record is not None:
            saved = {part.start: part for part in (*record.finished, record.current) if part}
            record.begin(saved.get(start) or Part(start, span.stop, y0, params))
        try:
            solution = integration(params, y0, times, done, look, record)
        except IntegrationError as stop:
            raise explained(stop, flow, scene, start, params) from None
        reported[span.rows], y0 = solution.y[:-1], solution.y[-1]
        solutions.append(solution)
    return ThinnedSegments(plan, solutions, read_only(reported))


class ThinnedSegments(Segments):
    """The segments of a long run: the times between copies of the run; see thinned_run.py."""

    def __init__(self, plan: Plan, solutions: list[ThinnedSolution], reported: Array) -> None:
        """Store the solutions.

        Args:
            plan: The plan, with as many spans as solutions.
            solutions: Solutions of the spans.
            reported: Reduced states at the report times of the scene, (T, k).
        """
        self._reported, self._times = reported, plan.scene.report_times
        self._divisions, self._spans = divisions_of(plan), plan.spans
        self._parts = [
            (span, solution, k)
            for span, solution in zip(plan.spans, solutions, strict=True)
            for k in range(len(solution.copies) - 1)
        ]
        self.ends = np.array([self._end(j) for j in range(len(self._parts))])
        last = [solution.copies[-1] for solution in solutions]
        self.steps = sum(copy.steps for copy in last)
        self.evaluations = sum(copy.evaluations for copy in last)

    def _end(self, j: int) -> float:
        span, solution, k = self._parts[j]
        last = k == len(solution.copies) - 2
        return span.stop if last else span.start + solution.copies[k + 1].time

    def reported(self, t: Array) -> Array | None:
        """Return the stored reduced states (T, k) if `t` is the array of report times."""
        return self._reported if t is self._times else None

    def __getitem__(self, j: int | slice) -> Segment | list[Segment]:  # type: ignore[override]
        if isinstance(j, slice):
            return [self._segment(i) for i in range(*j.indices(len(self)))]
        return self._segment(range(len(self))[j])

    def _segment(self, j: int) -> Segment:
        span, solution, k = self._parts[j]
        first, last = solution.copies[k : k + 2]
        end = float(self.ends[j])

        def step_ends() -> Array:
            knots = refined(solution.step_ends(k) + span.start, self._divisions)
            knots[-1] = end
            return knots

        def at(t: Array) -> Array:
            return solution.at(k, np.clip(t - span.start, first.time, last.time))

        counts = last.steps - first.steps, last.evaluations - first.evaluations
        return Segment(end, step_ends, at, solution.params, *counts)
