"""Long segments with equal steps, whose step ends are not stored, for events and controllers.

An event observes the steps of one pause after another, integrated again from its start.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...common.arrays import Array, read_only
from ...common.errors import IntegrationError
from ...integrators.methods import EqualSteps
from ...integrators.methods.method import registers_of
from ...integrators.run_keeper import RunKeeper
from ...integrators.thinned_run import MOST_COPIES, ThinnedIntegration, ThinnedSolution
from ..plan import Plan
from ..reduced_flow import Integrate, Segment
from .compiled_flow import CompiledFlow
from .integrator import divisions_of, explained, refined
from .thinned_segments import FEW, stores_few, wild_check

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
    divisions = divisions_of(plan)

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
            return _segment(solution, start, length, known, divisions)

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


def _segment(
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
