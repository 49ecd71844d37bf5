"""Integration of a plan with the compiled engine, with failures explained in terms of the robot.

Runs go from one stop to the next and store all step ends, or through all stops with one call of
compiled code.  Long runs with equal steps store few states.  An event observes the steps of one
pause of a long run after another, integrated again from its start.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import cached_property, partial
from typing import Any, NamedTuple
from weakref import ref

import numpy as np

from ...common.arrays import Array, read_only
from ...common.errors import (
    IntegrationError,
    NoConvergence,
    NonFiniteState,
    StepSizeUnderflow,
    TooManySteps,
)
from ...common.memo import once
from ...common.names import quoted
from ...common.waiting import Progress
from ...forces.switch_times import time_within
from ...integrators.integrate import Integration, Parts, integrate_parts
from ...integrators.methods import EqualSteps, ErrorControl, Method
from ...integrators.methods.method import registers_of
from ...integrators.run_keeper import RunKeeper
from ...integrators.solution import Solution
from ...integrators.thinned_run import MOST_COPIES, ThinnedIntegration, ThinnedSolution
from ...kernels.derived_code import tangent_of
from ...kernels.kernel import Kernel
from ...reduction.canonical_form import lost_inertia
from ...scene.scene import Scene
from ..checkpoint import Checkpoint, Part, RunRecord
from ..closed_loops import near_singular_loops
from ..motion import Segments
from ..plan import Plan
from ..reduced_flow import Integrate, Segment
from ..trajectory import Again, Trajectory, integrate_plan
from .compiled_flow import CompiledFlow


class _Shared(NamedTuple):
    """The integration of a structure with a kernel, which it does not keep alive."""

    kernel: ref[Kernel]
    method: Method
    integration: Integration


def _tangent_of(kernel: ref[Kernel]) -> int:
    """Return the address of the derivative of a kernel that is in use."""
    used = kernel()
    assert used is not None
    return tangent_of(used).address


_compiled_methods: set[type[Method]] = set()
# Largest rotation of a joint within one step of constant length [rad].
_WILD = 100.0
_NO_TIMES = read_only(np.empty(0))


def integrator(
    flow: CompiledFlow,
    plan: Plan,
    progress: Callable[[float], None] | None,
    *,
    chunk: int | None = None,
) -> Integrate:
    """Return the function that integrates a compiled flow from one time of its plan to another.

    Args:
        flow: The flow of the plan.
        plan: The plan.
        progress: Called repeatedly with the completed fraction of the time, 0 to 1.
        chunk: Number of steps after which `watch` is first called; None if runs are complete.
    Returns:
        The function, which raises an IntegrationError with time and shape if it fails.
    """
    scene, method, layout = plan.scene, plan.method, flow.kernel.layout
    divisions = plan.divisions

    n = max(1, len(flow.y0))

    def prepare(end: float, times: Array, tangent: Callable[[], int] = flow.tangent) -> Integration:
        return Integration(
            method,
            flow.address(method),
            n,
            end,
            times,
            layout.quaternions,
            flow.kernel.canonical,
            tangent,
            chunk,
        )

    def whole() -> Integration:
        """Return the integration over the whole time, which scenes of one structure share."""
        shared: dict[int, _Shared] = once(scene.shared, Integration, dict)
        found = shared.get(id(flow.kernel))
        if found is None or found.kernel() is not flow.kernel or found.method != method:
            for dropped in [k for k, each in list(shared.items()) if each.kernel() is None]:
                shared.pop(dropped, None)
            kernel = ref(flow.kernel)
            integration = prepare(scene.end, scene.report_times, partial(_tangent_of, kernel))
            found = shared[id(flow.kernel)] = _Shared(kernel, method, integration)
        return found.integration

    def run(
        start: float,
        end: float,
        y0: Array,
        parameters: Array,
        watch: Callable[[Segment], bool] | None = None,
        keeper: RunKeeper | None = None,
    ) -> Segment:
        # The time of an integration starts at 0; time-dependent equations have the true time in y.
        is_complete = chunk is None and start == 0.0 and end == scene.end
        done = progress and (lambda part: progress((start + part * (end - start)) / scene.end))
        y0 = y0 if y0.size else np.zeros(1)

        def segment(solution: Solution) -> Segment:
            def knots() -> Array:
                return refined(solution.knots + start, divisions)

            def at(t: Array) -> Array:
                if t is solution.times:
                    return solution.y
                return solution.at(np.clip(t - start, 0.0, solution.knots[-1]))

            counts = solution.steps, solution.evaluations
            if not solution.complete:  # its step ends will change
                return Segment.stored(knots(), at, parameters, *counts)

            def exact() -> Array:
                times = knots()
                times[-1] = end  # despite round-off in the sum of step lengths
                return times

            return Segment(end, exact, at, parameters, *counts)

        integrate = whole() if is_complete else prepare(end - start, _NO_TIMES)
        try:
            solution = integrate(
                parameters,
                y0,
                progress=done,
                watch=watch and (lambda part: watch(segment(part))),
                keeper=keeper,
            )
        except IntegrationError as stop:
            raise explained(stop, flow, scene, start, parameters) from None
        if not method.adaptive:
            wild = wild_steps(flow.kernel, plan, solution.states, solution.knots)
            if wild:
                raise IntegrationError(wild)
        return segment(solution)

    if type(method) not in _compiled_methods:
        # The first integration compiles the method; this time must not count as run time.
        _compiled_methods.add(type(method))
        with suppress(IntegrationError):  # the real run raises the same error
            run(0.0, 1e-9 * scene.end, flow.y0, read_only(flow.parameters.copy()))
    return run


def wild_steps(kernel: Kernel, plan: Plan, states: Array, times: Array) -> str:
    """Describe the fault if a joint rotates several turns within a step of constant length.

    No error control shortens these steps.  Cyclic joints, such as wheels, are exempt because their
    momentum is constant.  If the states are several steps apart, their mean step is checked.

    Args:
        kernel: The kernel.
        plan: The plan.
        states: Reduced states, (T, k).
        times: Times of the states, (T,) [s].
    Returns:
        The fault as a sentence, or "" if there is no fault.
    """
    step = getattr(plan.method, "step", None)
    active = list(kernel.layout.active)
    if step is None or not active:
        return ""
    ends = np.unique(np.searchsorted(times, np.arange(0.0, times[-1], step)))
    ends = np.append(ends[ends < len(times) - 1], len(times) - 1)
    steps = np.maximum(np.diff(times[ends]) / step, 1.0)
    turned = np.abs(np.diff(states[ends, : len(active)], axis=0)) / steps[:, None]
    names, units = plan.system.shape_names, plan.system.units
    for k, most in zip(active, turned.max(axis=0, initial=0.0), strict=True):
        if units[k] == "rad" and not most < _WILD:
            return (
                f"joint {quoted(names[k])} of '{plan.system.name}' rotates by {most:.1e} rad "
                f"within one step of {step:g} s, which {plan.method.name} cannot resolve; use "
                "shorter steps, or a method with step control"
            )
    return ""


def refined(knots: Array, parts: int) -> Array:
    """Divide each step between knots into a number of equal parts."""
    if parts == 1:
        return knots
    steps = np.arange(len(knots))
    return np.asarray(np.interp(np.arange(parts * (len(knots) - 1) + 1) / parts, steps, knots))


def explained(
    stop: IntegrationError, flow: CompiledFlow, scene: Scene, start: float, parameters: Array
) -> IntegrationError:
    """Return a failure of the integrator, explained in terms of the robot.

    Args:
        stop: The failure, with its time counted from `start`.
        flow: The flow.
        scene: The scene.
        start: Start time of the segment [s].
        parameters: Parameters of the vector field in the segment, (p,).
    Returns:
        The error to raise instead.
    """
    if not isinstance(stop, (NonFiniteState, StepSizeUnderflow, NoConvergence, TooManySteps)):
        return stop
    name, time = scene.system.name, start + stop.time
    x = flow.shape(time, stop.state, parameters)
    shape = f"shape x = {x}{lost_inertia(scene.system, x)}{near_singular_loops(scene.system, x)}"
    if isinstance(stop, NonFiniteState):
        entry = flow.entry_name(stop.entry)
        message = f"{entry} of '{name}' is not finite after t = {time:g} s, at {shape}"
        return NonFiniteState(message, time, stop.state, stop.entry)
    return type(stop)(
        f"'{name}' cannot be integrated beyond t = {time:g} s of {scene.end:g} s at "
        f"rtol = {scene.rtol:g}, {shape}: {stop}",
        time,
        stop.state,
    )


_methods_through_stops: set[type[ErrorControl]] = set()


def through_stops(
    flow: CompiledFlow, plan: Plan, progress: Callable[[float], None] | None
) -> Callable[[], Segments] | None:
    """Return the function that integrates a flow through all stops of its plan.

    Args:
        flow: The flow of the plan.
        plan: The plan, for which `passes_stops` is true.
        progress: Called repeatedly with the completed fraction of the stops, 0 to 1.
    Returns:
        The function; None for methods without step control, whose steps depend on each span.
    """
    method = plan.method
    if not isinstance(method, ErrorControl):
        return None

    def run(stops: Array) -> PartSegments:
        starts = np.append(0.0, stops[:-1])
        params = flow.parameters_within(time_within(starts, stops))

        def explain(stop: IntegrationError, k: int) -> IntegrationError:
            return explained(stop, flow, plan.scene, float(starts[k]), params[k])

        kernel = flow.kernel
        parts = integrate_parts(
            method, flow.address(method), params, flow.y0 if flow.y0.size else np.zeros(1),
            read_only(stops - starts), kernel.layout.quaternions, kernel.canonical, flow.tangent,
            progress, explain,
        )  # fmt: skip
        return PartSegments(parts, starts, stops, plan.divisions)

    def through() -> Segments:
        return run(plan.stops)

    if type(method) not in _methods_through_stops:
        # The first integration compiles the method; this time must not count as run time.
        _methods_through_stops.add(type(method))
        with suppress(IntegrationError):  # the real run raises the same error
            run(1e-9 * plan.stops[:1])
    return through


class PartSegments(Segments):
    """The segments of a run over parts of time; each is created at first access."""

    def __init__(self, parts: Parts, starts: Array, stops: Array, divisions: int) -> None:
        """Store the solutions.

        Args:
            parts: Solutions of the S parts.
            starts: Start times of the parts, (S,) [s].
            stops: End times of the parts, (S,) [s].
            divisions: Number of parts into which each long step is divided.
        """
        self._parts, self._starts, self._divisions = parts, starts, divisions
        self.ends, self.steps, self.evaluations = stops, parts.steps, parts.evaluations

    @cached_property
    def knots(self) -> Array:
        """Times of all step ends, (K,) sorted [s]."""
        parts, counts = self._parts, np.diff(self._parts.first)
        times = parts.knots[: parts.first[-1]] + np.repeat(self._starts, counts)
        times[parts.first[1:] - 1] = self.ends  # exact, despite round-off in sums of step lengths
        return np.unique(refined(np.unique(times), self._divisions))

    def __getitem__(self, k: Any) -> Any:
        if isinstance(k, slice):
            return [self[i] for i in range(*k.indices(len(self)))]
        k = range(len(self))[k]
        solution, start = self._parts[k], float(self._starts[k])
        knots = refined(solution.knots + start, self._divisions)
        knots[-1] = self.ends[k]

        def at(t: Array) -> Array:
            return solution.at(np.clip(t - start, 0.0, solution.knots[-1]))

        return Segment.stored(knots, at, solution.params, solution.steps, solution.evaluations)


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
        controllers, see `long_integrator`.
    """
    if plan.is_observed or not stores_few(flow, plan, method):
        return None
    return lambda: _integrate_thinned(flow, plan, method, progress, record)


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


def _integrate_thinned(
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
        self._divisions, self._spans = plan.divisions, plan.spans
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


# Step ends of shorter segments are stored; a copy of a run takes as much memory as some steps.
_LEAST_STEPS = 64


def long_integrator(
    flow: CompiledFlow,
    plan: Plan,
    method: EqualSteps,
    integrate: Integrate,
    progress: Callable[[float], None] | None,
) -> Integrate | None:
    """Return a function that integrates from stop to stop and stores few states.

    Args:
        flow: The flow of the plan.
        plan: The plan.
        method: The method of the plan.
        integrate: The function that stores all step ends, for short segments.
        progress: Called repeatedly with the completed fraction of the time, 0 to 1.
    Returns:
        The function; None if all step ends take little memory.
    """
    scene = plan.scene
    if not stores_few(flow, plan, method):
        return None
    kernel, address, look = flow.kernel, flow.address(method), wild_check(flow, plan)
    divisions = plan.divisions

    def run(
        start: float,
        end: float,
        y0: Array,
        parameters: Array,
        watch: Callable[[Segment], bool] | None = None,
        keeper: RunKeeper | None = None,
    ) -> Segment:
        length, reports = end - start, scene.report_times
        reports = reports[(reports > start) & (reports <= end)]
        steps = registers_of(method, length)["total"]
        if steps < max(_LEAST_STEPS, FEW * len(reports)):
            return integrate(start, end, y0, parameters, watch, keeper)
        y0 = y0 if y0.size else np.zeros(1)
        integration = ThinnedIntegration(
            method, address, len(y0), length, kernel.layout.quaternions, kernel.canonical,
            flow.tangent,
        )  # fmt: skip
        times = read_only(np.append((reports - start).clip(0.0, length), length))
        known = np.append(reports, end)

        def segment(solution: ThinnedSolution) -> Segment:
            return _long_segment(solution, start, length, known, divisions)

        try:
            solution = integration(
                parameters, y0, times,
                progress and (lambda part: progress((start + part * length) / scene.end)),
                look, keeper, watch and (lambda part: watch(segment(part))),
                max(1, round(MOST_COPIES * length / scene.end)),
            )  # fmt: skip
        except IntegrationError as stop:
            raise explained(stop, flow, scene, start, parameters) from None
        return segment(solution)

    return run


def _long_segment(
    solution: ThinnedSolution, start: float, length: float, known: Array, divisions: int
) -> Segment:
    """Return the segment of a solution or of a part of it.

    Args:
        solution: The solution.
        start: Start time of the segment [s].
        length: Length of the whole segment [s].
        known: Report times and the end time of the whole segment [s].
        divisions: Number of parts into which a step is divided for its users.
    """
    first, last = solution.copies[0], solution.copies[-1]
    end = float(known[-1]) if last.time >= length else start + last.time
    count = len(solution.y)

    def step_ends() -> Array:
        parts = [solution.step_ends(k) for k in range(len(solution.copies) - 1)]
        knots = refined(np.concatenate([parts[0], *[p[1:] for p in parts[1:]]]) + start, divisions)
        knots[-1] = end
        return knots

    def at(t: Array) -> Array:
        if count:
            rows = np.minimum(np.searchsorted(known[:count], t), count - 1)
            if (known[rows] == t).all():
                return np.asarray(solution.y[rows])
        return solution.anywhere(np.clip(t - start, first.time, last.time))

    steps, evaluations = last.steps - first.steps, last.evaluations - first.evaluations
    return Segment(end, step_ends, at, solution.params, steps, evaluations)


def run_compiled(
    plan: Plan, progress: Progress | None, again: Again, checkpoint: Checkpoint | None = None
) -> Trajectory:
    """Return the trajectory of a plan, integrated with machine code.

    Args:
        plan: The plan.
        progress: Called repeatedly with the completed fraction of the time, 0 to 1.
        again: Function that simulates the scene again; see Trajectory.
        checkpoint: Checkpoint that the run continues and updates; or None.
    Returns:
        The trajectory.
    Raises:
        IntegrationError: The integrator cannot continue.
    """
    flow = CompiledFlow.of_plan(plan)
    record = None if checkpoint is None else checkpoint.run(flow, plan)
    method, through, long = plan.method, None, None
    if isinstance(method, EqualSteps):
        through = thinned(flow, plan, method, progress, record)
    if through is None and plan.passes_stops and record is None:
        through = through_stops(flow, plan, progress)
    integrate = integrator(flow, plan, progress)
    if isinstance(method, EqualSteps) and through is None:
        long = long_integrator(flow, plan, method, integrate, progress)
    integrate = long or integrate
    trajectory = integrate_plan(
        plan, flow, integrate, "compiled", plan.method_name, again, through, record,
        thinned=long is not None,
    )  # fmt: skip
    if checkpoint is not None and record is not None:
        checkpoint.close(record, flow, plan, cut=trajectory.ended_by is not None)
    return trajectory
