"""The integrator of the Pinocchio engine: SciPy's DOP853."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.integrate import DOP853, DenseOutput, OdeSolution

from ...common.arrays import Array
from ...common.errors import IntegrationError
from ...integrators.methods import DOP853_LEAST
from ...integrators.run_keeper import RunKeeper
from ...reduction.inertia_split import lost_inertia
from ..plan import Plan
from ..reduced_flow import Integrate, Segment
from .pinocchio_flow import PinocchioFlow

MOST_STEPS = 1_000_000
DEGREE = 7  # of the dense output of DOP853 within a step


def integrator(
    flow: PinocchioFlow, plan: Plan, progress: Callable[[float], None] | None
) -> Integrate:
    """Return the function that integrates a flow from one time of its plan to another.

    Args:
        flow: The flow of the plan.
        plan: The plan.
        progress: Called after each step with the completed fraction of the time, 0 to 1.
    Returns:
        The function; its IntegrationError states the time and the entry of the reduced state.
    """
    scene = plan.scene
    rtol, atol = scene.tolerance
    rtol = max(rtol, DOP853_LEAST)

    def run(
        start: float,
        end: float,
        y0: Array,
        parameters: Array,
        watch: Callable[[Segment], bool] | None = None,
        keeper: RunKeeper | None = None,  # noqa: ARG001
    ) -> Segment:
        if y0.size == 0:  # a single body that only translates has no reduced state
            return Segment.stored(
                np.array([start, end]), lambda t: np.empty((len(t), 0)), parameters, 0, 0
            )

        def rate(t: float, y: Array) -> Array:
            return flow.rate(t, y, parameters)

        solver = DOP853(rate, start, y0, end, plan.longest, rtol, atol)
        knots: list[float] = [start]

        def lost() -> str:
            y = solver.y if np.isfinite(solver.y).all() else solver.y_old
            return lost_inertia(scene.system, flow.shape(solver.t, y, parameters))

        steps: list[DenseOutput] = []

        def so_far() -> Segment:
            dense = OdeSolution(knots, steps)
            return Segment.stored(
                np.array(knots), lambda t: np.asarray(dense(t)).T, parameters, len(steps),
                solver.nfev,
            )  # fmt: skip

        while solver.status == "running":
            if watch is not None and steps and watch(so_far()):
                return so_far()
            if len(steps) >= MOST_STEPS:
                raise IntegrationError(
                    f"'{scene.system.name}' reached the limit of {MOST_STEPS} steps at t = "
                    f"{solver.t:g} s, before the end at {scene.end:g} s; shorten the scene or "
                    f"loosen the tolerance{lost()}"
                )
            with np.errstate(over="ignore", invalid="ignore"):  # overflows are reported below
                message = solver.step()
                step = solver.dense_output() if solver.status != "failed" else None
            if not np.isfinite(solver.y).all():
                entry = int(np.argmin(np.isfinite(solver.y)))
                raise IntegrationError(
                    f"{flow.entry_name(entry)} of '{scene.system.name}' is not finite after "
                    f"t = {knots[-1]:g} s{lost()}"
                )
            if solver.status == "failed":
                raise IntegrationError(
                    f"'{scene.system.name}' cannot be integrated beyond t = {solver.t:g} s of "
                    f"{scene.end:g} s at rtol = {scene.rtol:g}: {message}{lost()}"
                )
            knots.append(solver.t)
            steps.append(step)
            if progress is not None:
                progress(solver.t / scene.end)
        return so_far()

    return run
