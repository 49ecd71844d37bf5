"""Integrate a compiled flow, with failures told in terms of the robot."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import numpy as np

from ...common.arrays import Array, read_only
from ...common.errors import (
    IntegrationError,
    NoConvergence,
    NonFiniteState,
    StepSizeUnderflow,
    TooManySteps,
)
from ...common.plain_names import quoted
from ...integrators.integrate import Solution, integrate_checked
from ...integrators.methods import Method
from ...kernels.kernel import Kernel
from ...reduction.inertia_split import lost_inertia
from ...scene.scene import Scene
from ...system.joints import joint_units
from ..piece import Integrate, Piece
from ..plan import Plan
from .compiled_flow import CompiledFlow

_prepared: set[type[Method]] = set()
_WILD = 100.0  # rad in one step
_NO_TIMES = read_only(np.empty(0))


def prepare(flow: CompiledFlow, plan: Plan) -> None:
    """Have the machine code of kernel and integrator ready: a run's time is then its own."""
    method = plan.method
    flow.address(method)
    if type(method) in _prepared:
        return
    _prepared.add(type(method))
    with suppress(IntegrationError):  # the run itself will say so
        integrator(flow, plan, None)(0.0, 1e-9 * plan.scene.end, flow.y0)


def integrator(
    flow: CompiledFlow, plan: Plan, progress: Callable[[float], None] | None
) -> Integrate:
    """Return what integrates a flow from one time of its plan to another.

    That raises an IntegrationError with time and shape.
    """
    scene, method, layout = plan.scene, plan.method, flow.kernel.layout
    asked, address = scene.report_times, flow.address(method)
    # Between knots the power of a force is like a polynomial of degree 7; a step of eight
    # stages is too long for that.
    parts = max(1, method.order // 4) if method.lanes > 1 else 1

    def run(
        start: float, end: float, y0: Array, watch: Callable[[Piece], bool] | None = None
    ) -> Piece:
        # The integrators' time begins at 0; what depends on the time has it in its state.
        whole = start == 0.0 and end == scene.end
        # Read-only as ever: to numba an array that is not is of another type.
        times = asked if whole else _NO_TIMES
        parameters = read_only(flow.parameters.copy())
        numbers = parameters[len(parameters) - len(flow.numbers) :]
        done = progress and (lambda part: progress((start + part * (end - start)) / scene.end))
        y0 = y0 if y0.size else np.zeros(1)

        def made(found: Solution, *, complete: bool) -> Piece:
            knots = _refined(found.knots + start, parts)
            if complete:
                knots[-1] = end  # whatever round-off says

            def at(t: Array) -> Array:
                if t is asked and whole and complete:  # these have been asked for already
                    return found.y
                return found.at(np.clip(t - start, 0.0, found.knots[-1]))

            return Piece(knots, at, numbers, found.steps, found.evaluations)

        try:
            found = integrate_checked(
                method,
                address,
                parameters,
                y0,
                end - start,
                times,
                layout.quaternion,
                done,
                flow.tangent,
                layout.canonical,
                watch and (lambda found: watch(made(found, complete=False))),
            )
        except IntegrationError as stop:
            raise explained(stop, flow, scene, start) from None
        wild = wild_steps(flow.kernel, plan, found.states, found.knots)
        if wild:
            raise IntegrationError(wild)
        return made(found, complete=found.complete)

    return run


def wild_steps(kernel: Kernel, plan: Plan, states: Array, times: Array) -> str:
    """Return what is wrong with a run of equal steps in one of which a joint turns many times.

    Nothing controls the error of such steps, and no method follows a joint so far in one.  Joints
    whose momentum is constant, as of wheels, may turn as fast as they like.  Where
    states are more than a step apart, the mean of their steps counts.
    """
    step = getattr(plan.method, "step", None)
    active = list(kernel.layout.active)
    if step is None or not active:
        return ""
    ends = np.unique(np.searchsorted(times, np.arange(0.0, times[-1], step)))
    ends = np.append(ends[ends < len(times) - 1], len(times) - 1)
    steps = np.maximum(np.diff(times[ends]) / step, 1.0)
    turned = np.abs(np.diff(states[ends, : len(active)], axis=0)) / steps[:, None]
    names, units = plan.system.shape_names, joint_units(plan.system.model)
    for k, most in zip(active, turned.max(axis=0, initial=0.0), strict=True):
        joint = plan.system.joint_number(names[k])
        if units[joint] == "rad" and not most < _WILD:
            return (
                f"joint {quoted(names[k])} of '{plan.system.name}' turns by {most:.1e} rad within "
                f"one step of {step:g} s, which {plan.method.name} cannot follow; take shorter "
                "steps, or a method with step control"
            )
    return ""


def _refined(knots: Array, parts: int) -> Array:
    """Return knots with every step in so many parts."""
    if parts == 1:
        return knots
    steps = np.arange(len(knots))
    return np.asarray(np.interp(np.arange(parts * (len(knots) - 1) + 1) / parts, steps, knots))


def explained(
    stop: IntegrationError, flow: CompiledFlow, scene: Scene, start: float
) -> IntegrationError:
    """Return a failure in terms of the robot."""
    name = scene.system.name
    if isinstance(stop, NonFiniteState):
        time = start + stop.time
        x = flow.shape(time, stop.state)
        return NonFiniteState(
            f"{flow.entry_name(stop.entry)} of '{name}' is not finite after t = {time:g} s, "
            f"at shape x = {x}{lost_inertia(scene.system, x)}",
            time,
            stop.state,
            stop.entry,
        )
    if isinstance(stop, (StepSizeUnderflow, NoConvergence, TooManySteps)):
        time = start + stop.time
        x = flow.shape(time, stop.state)
        return type(stop)(
            f"'{name}' cannot be followed beyond t = {time:g} s of {scene.end:g} s at "
            f"rtol = {scene.rtol:g}, shape x = {x}{lost_inertia(scene.system, x)}: {stop}",
            time,
            stop.state,
        )
    return stop
