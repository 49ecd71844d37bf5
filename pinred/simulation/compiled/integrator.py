"""Integration of a compiled flow, with failures explained in terms of the robot."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import NamedTuple
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
from ...integrators.integrate import Integration
from ...integrators.methods import Method
from ...integrators.run_keeper import RunKeeper
from ...integrators.solution import Solution
from ...kernels.derived_code import tangent_of
from ...kernels.kernel import Kernel
from ...reduction.inertia_split import lost_inertia
from ...scene.scene import Scene
from ..plan import Plan
from ..reduced_flow import Integrate, Segment
from ..singular_loops import near_singular_loops
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
    divisions = divisions_of(plan)

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


def divisions_of(plan: Plan) -> int:
    """Return the number of parts into which a step is divided for its users.

    Balances fit polynomials of degree 7 between knots, so steps of eight stages are split.
    """
    method = plan.method
    return max(1, method.order // 4) if method.lanes > 1 else 1


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
