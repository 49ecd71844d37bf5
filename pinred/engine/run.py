"""Integrate a compiled flow, with failures told in terms of the robot."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import numpy as np

from ..errors import IntegrationError, NonFiniteState, StepSizeUnderflow, TooManySteps
from ..integrators.drive import Solution
from ..integrators.drive import integrate as _integrate
from ..integrators.method import DOP853
from ..scene import Scene
from .flow import CompiledFlow

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
    y0, quaternion, times = flow.y0, flow.kernel.layout.quaternion, scene.report_times
    if y0.size == 0:  # one body that only translates: carry a zero, which costs nothing
        y0 = np.zeros(1)
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
