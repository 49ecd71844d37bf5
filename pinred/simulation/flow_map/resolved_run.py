"""Runs of a flow whose steps resolve the functions of time in its forces."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...common.arrays import Array
from ...common.errors import AccuracyWarning
from ...integrators.solution import Solution
from ..compiled.compiled_flow import CompiledFlow
from ..plan import Plan, Span
from ..singular_loops import may_pass_singular_shape, refuse_singular_shapes
from ..time_resolution import (
    RERUNS,
    describe_unresolved,
    joined_stops,
    states_differ,
    unresolved_times,
)
from .inputs import Given


@dataclass
class Run:
    """One evaluation of a flow map.

    Attributes:
        given: The inputs.
        flow: The compiled flow that starts from these inputs.
        spans: Time spans between the stops of the run.
        solutions: Solution over each span.
    """

    given: Given
    flow: CompiledFlow
    spans: list[Span]
    solutions: list[Solution]


Solve = Callable[[Array], tuple[list[Span], list[Solution]]]


def resolve_run(
    plan: Plan, numbers: Array, spans: list[Span], solutions: list[Solution], solve: Solve
) -> tuple[list[Span], list[Solution]]:
    """Return the spans and solutions of a run, with more stops if it skips functions of time.

    Args:
        plan: The plan of the scene.
        numbers: Force parameters of the run, (p,).
        spans: Time spans between the stops of the run.
        solutions: Solution over each span.
        solve: Function from stops, (S,) [s], to the spans and solutions of a run.
    Returns:
        Spans and solutions. If functions are still not resolved after two more runs, and the last
        run has changed the final state, an AccuracyWarning is emitted.
    """
    forces, last = plan.forces, solutions
    if forces is None:
        return spans, solutions
    for run in range(RERUNS + 1):
        knots = _step_ends(spans, solutions)
        times = unresolved_times(plan, forces, numbers, knots, type(plan.method))
        if not times.size:
            break
        if run == RERUNS:
            before, after = (each[-1].states[-1:] for each in (last, solutions))
            if states_differ(plan, before, after):
                warnings.warn(describe_unresolved(plan, times), AccuracyWarning, stacklevel=5)
            break
        stops = joined_stops(np.array([span.stop for span in spans]), times)
        last, (spans, solutions) = solutions, solve(stops)
    return spans, solutions


def refuse_singular_run(run: Run) -> None:
    """Reject a run through a shape at which the equations of closed loops become dependent.

    Args:
        run: The run.
    Raises:
        IntegrationError: The run passes such a shape.
    """
    flow, system = run.flow, run.flow.kernel.system
    if system.closure is None:
        return
    for span, solution in zip(run.spans, run.solutions, strict=True):

        def shapes_at(t: Array, span: Span = span, solution: Solution = solution) -> Array:
            y = solution.at(t - span.start)
            return flow.outputs(t, y, solution.params)[:, flow.kernel.where.fields["x"]]

        knots = span.start + solution.knots
        if may_pass_singular_shape(system, shapes_at(knots)):
            refuse_singular_shapes(system, knots, shapes_at)


def _step_ends(spans: list[Span], solutions: list[Solution]) -> Array:
    """Return the times of the ends of steps, with the start of the run, (K + 1,) [s]."""
    pairs = zip(spans, solutions, strict=True)
    ends = [span.start + solution.knots[1:] for span, solution in pairs]
    return np.concatenate([np.zeros(1), *ends])
