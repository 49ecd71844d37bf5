"""Runs of a flow whose steps resolve the functions of time in its forces."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ...common.arrays import Array, read_only
from ...common.errors import AccuracyWarning
from ...integrators.solution import Solution
from ..closed_loops import may_pass_singular_shape, refuse_singular_shapes
from ..compiled.compiled_flow import CompiledFlow
from ..plan import Plan, Span
from ..step_limits import step_limits
from ..step_resolution import (
    Steps,
    describe_unresolved,
    order_of,
    resolved_runs,
    steps_to_check,
    tolerance_of,
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


Solve = Callable[[Plan], tuple[list[Span], list[Solution]]]


def resolve_run(
    plan: Plan, flow: CompiledFlow, spans: list[Span], solve: Solve
) -> tuple[list[Span], list[Solution]]:
    """Return the spans and solutions of a run whose steps resolve all functions of time.

    Args:
        plan: The plan of the scene.
        flow: The compiled flow of the run.
        spans: Time spans between the stops of the run.
        solve: Function from a plan to the spans and solutions of a run.
    Returns:
        Spans and solutions. If a function cannot be resolved, an AccuracyWarning is emitted.
    """
    assert plan.forces is not None
    tolerance = tolerance_of(plan, "compiled")
    end, order = plan.scene.end, order_of(plan)
    limits = step_limits(plan.forces, end, flow.numbers, tolerance[0], order)
    bare = replace(plan, stops=read_only(np.array([span.stop for span in spans])))

    def steps_of(solved: tuple[list[Span], list[Solution]]) -> list[Steps]:
        pairs = list(zip(*solved, strict=True))
        ends = np.concatenate([np.zeros(1), *(_ends_of(*pair)[1:] for pair in pairs)])
        chosen = steps_to_check(limits, ends, np.array([span.stop for span, _ in pairs]))
        return [_steps_of(flow, *pairs[k]) for k in chosen]

    runs = resolved_runs(limits, tolerance, lambda each: solve(bare.limited(*each)), steps_of)
    if limits.unresolved.size:
        warnings.warn(describe_unresolved(plan, limits.unresolved), AccuracyWarning, stacklevel=5)
    return runs[-1]


def _ends_of(span: Span, solution: Solution) -> Array:
    """Return the ends of the steps of a solution, with the start of the first, (K + 1,) [s]."""
    ends = span.start + solution.knots
    ends[-1] = span.stop  # despite round-off in the sum of step lengths
    return ends


def _steps_of(flow: CompiledFlow, span: Span, solution: Solution) -> Steps:
    """Return the steps of a solution over a span."""

    def at(t: Array) -> Array:
        return solution.at(np.clip(t - span.start, 0.0, solution.knots[-1]))

    def rates(t: Array, y: Array) -> Array:
        return flow.rates(t, y, solution.params)

    return Steps(_ends_of(span, solution), at, rates)


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
