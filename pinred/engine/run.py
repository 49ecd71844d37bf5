"""Integrate a compiled flow, with failures told in terms of the robot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import Array
from ..errors import IntegrationError, NonFiniteState, StepSizeUnderflow, TooManySteps
from ..integrators.drive import Solution
from ..integrators.drive import integrate as _integrate
from ..integrators.many import STATUS
from ..integrators.many import integrate_many as _integrate_many
from ..integrators.method import DOP853
from ..scene import Scene
from .flow import CompiledFlow


@dataclass(frozen=True)
class ManyRuns:
    """Runs of one kernel.  y: (N, T, k).  failures: (member, last time [s], reason) of each."""

    y: Array
    failures: list[tuple[int, float, str]]


def integrate_many(flows: Sequence[CompiledFlow], scene: Scene, threads: int | None) -> ManyRuns:
    """Integrate flows of one kernel, with the times and tolerance of one scene, over threads."""
    kernel = flows[0].kernel
    rtol, atol = scene.tolerance
    found = _integrate_many(
        DOP853(rtol=rtol, atol=atol),
        kernel.rate.address,
        np.array([flow.parameters for flow in flows]),
        np.array([_start(flow) for flow in flows]),
        scene.end,
        scene.report_times,
        kernel.layout.quaternion,
        threads,
    )
    failures = []
    for k in np.flatnonzero(~found.ok).tolist():
        reason = STATUS[int(found.status[k])]
        if found.entry[k] >= 0:
            reason = f"{flows[k].entry_name(int(found.entry[k]))} is {reason}"
        failures.append((int(k), float(found.end[k]), reason))
    return ManyRuns(found.y, failures)


def _start(flow: CompiledFlow) -> Array:
    """Return y0; one body that only translates carries a zero, which costs nothing."""
    return flow.y0 if flow.y0.size else np.zeros(1)


_prepared = False


def prepare(flow: CompiledFlow, scene: Scene) -> None:
    """Load the integrators' machine code, once for a process: a run's time is then its own."""
    global _prepared
    if _prepared:
        return
    _prepared = True
    with suppress(IntegrationError):  # the run itself will say so
        integrate(flow, replace(scene, duration=1e-9 * scene.end, times=None), None)


def integrate(
    flow: CompiledFlow, scene: Scene, progress: Callable[[float], None] | None
) -> Solution:
    """Integrate a flow to the end of its scene.

    Raises NonFiniteState, StepSizeUnderflow or TooManySteps with the time and shape.
    """
    y0, quaternion, times = _start(flow), flow.kernel.layout.quaternion, scene.report_times
    rtol, atol = scene.tolerance
    method = DOP853(rtol=rtol, atol=atol)
    name = scene.system.name
    try:
        return _integrate(
            method, flow.address, flow.parameters, y0, scene.end, times, quaternion, progress
        )
    except NonFiniteState as stop:
        x = flow.shape(stop.state)
        raise NonFiniteState(
            f"{flow.entry_name(stop.entry)} of '{name}' is not finite after t = {stop.time:g} s, "
            f"at shape x = {x}",
            stop.time,
            stop.state,
            stop.entry,
        ) from None
    except (StepSizeUnderflow, TooManySteps) as stop:
        raise type(stop)(
            f"'{name}' cannot be followed beyond t = {stop.time:g} s of {scene.end:g} s at "
            f"rtol = {scene.rtol:g}, shape x = {flow.shape(stop.state)}: {stop}",
            stop.time,
            stop.state,
        ) from None
