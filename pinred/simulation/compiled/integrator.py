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
from ...integrators.integrate import Integration, Parts, RunKeeper, Solution, integrate_parts
from ...integrators.methods import EqualSteps, ErrorControl, Method
from ...integrators.methods.method import registers_of
from ...integrators.thinned_run import MOST_COPIES, ThinnedIntegration, ThinnedSolution
from ...kernels.build import tangent_of
from ...kernels.kernel import Kernel
from ...reduction.canonical_form import lost_inertia
from ...scene.scene import Scene
from ..checkpoint import RunRecord
from ..closed_loops import near_singular_loops
from ..motion import Motion, Segments, Solver, follow
from ..plan import Plan
from ..reduced_flow import Integrate, Segment
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
    progress: Progress | None,
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
        entry = shared.get(id(flow.kernel))
        if entry is None or entry.kernel() is not flow.kernel or entry.method != method:
            for dropped in [k for k, old in list(shared.items()) if old.kernel() is None]:
                shared.pop(dropped, None)
            kernel = ref(flow.kernel)
            integration = prepare(scene.end, scene.report_times, partial(_tangent_of, kernel))
            entry = shared[id(flow.kernel)] = _Shared(kernel, method, integration)
        return entry.integration

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
    rotations = np.abs(np.diff(states[ends, : len(active)], axis=0)) / steps[:, None]
    names, units = plan.system.shape_names, plan.system.units
    for k, most in zip(active, rotations.max(axis=0, initial=0.0), strict=True):
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
    flow: CompiledFlow, plan: Plan, progress: Progress | None
) -> Callable[[], Segments] | None:
    """Return the function that integrates a flow through all stops of its plan.

    Args:
        flow: The flow of the plan.
        plan: The plan, with several stops and without controllers and events.
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


# Step ends of shorter segments are stored; a copy of a run takes as much memory as some steps.
_LEAST_STEPS = 64


def long_integrator(
    flow: CompiledFlow, plan: Plan, integrate: Integrate, progress: Progress | None
) -> Integrate | None:
    """Return a function that integrates from stop to stop and stores few states.

    Args:
        flow: The flow of the plan.
        plan: The plan.
        integrate: The function that stores all step ends, for short segments.
        progress: Called repeatedly with the completed fraction of the time, 0 to 1.
    Returns:
        The function; None if the method has step control, or all step ends take little memory.
    """
    scene, method = plan.scene, plan.method
    if not (isinstance(method, EqualSteps) and stores_few(flow, plan, method)):
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
        reported = np.append(reports, end)

        def segment(solution: ThinnedSolution) -> Segment:
            return _long_segment(solution, start, length, reported, divisions)

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
        ends = [solution.step_ends(k) for k in range(len(solution.copies) - 1)]
        knots = refined(np.concatenate([ends[0], *[p[1:] for p in ends[1:]]]) + start, divisions)
        knots[-1] = end
        return knots

    def at(t: Array) -> Array:
        if count:
            indices = np.minimum(np.searchsorted(known[:count], t), count - 1)
            if (known[indices] == t).all():
                return np.asarray(solution.y[indices])
        return solution.anywhere(np.clip(t - start, first.time, last.time))

    steps, evaluations = last.steps - first.steps, last.evaluations - first.evaluations
    return Segment(end, step_ends, at, solution.params, steps, evaluations)


def compiled_solver(plan: Plan) -> Solver:
    """Return the compiled engine for a plan."""
    return Solver(plan.method_name, plan.method.order, CompiledFlow.of_plan, integrator, _motion)


def _motion(
    flow: CompiledFlow, plan: Plan, progress: Progress | None, record: RunRecord | None
) -> Callable[[], Motion]:
    """Return the function that integrates a plan: through all stops, or from stop to stop."""
    if len(plan.stops) > 1 and not plan.is_observed and record is None:
        through = through_stops(flow, plan, progress)
        if through is not None:
            return lambda: Motion(flow, through(), varies=bool(plan.driven))
    integrate = integrator(flow, plan, progress)
    long = long_integrator(flow, plan, integrate, progress)
    return partial(follow, plan, flow, long or integrate, record, thinned=long is not None)
