"""Run: one evaluation of a flow, with steps that resolve functions of time, and the adjoint."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from ...common.arrays import Array, read_only
from ...common.errors import AccuracyWarning
from ...integrators.integrate import Solution
from ...integrators.stepping.compiling import compiled
from ...integrators.stepping.intrinsics import call, call_adjoint
from ...kernels.flow_functions import Row, outcome_of, reference_in, reference_size
from ...kernels.kernel import Kernel
from ...system.coordinates import Indices
from ..closed_loops import may_pass_singular_shape, refuse_singular_shapes
from ..compiled.compiled_flow import CompiledFlow
from ..longest_steps import step_limits
from ..plan import Plan, Span
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


# Covectors of rows of the outputs at T times of a segment, and their derivatives: start of the
# segment [s]; times after the start, (T,) [s]; reduced states at these times, (T, n), read-only;
# constants of the kernel, (p,); covectors of the rows, (T, rows); derivatives with respect to the
# states, (T, n), overwritten, and to the constants, (p,), to which the result is added.
OutputCovectors: TypeAlias = tuple[float, Array, Array, Array, Array, Array, Array]


class OutcomeAdjoint:
    """The adjoint of a kernel's outputs at all times of a segment, in one call."""

    def __init__(self, kernel: Kernel, rows: tuple[Row, ...]) -> None:
        """Prepare the adjoint of the given rows of the outputs."""
        layout, system, size = kernel.layout, kernel.system, kernel.where.size
        self._outputs, self._outcome = kernel.outputs, outcome_of(kernel, rows)
        self._size, self._output_size = layout.size, size
        self._argument_size = layout.size + 1 + reference_size(system)
        # Numbers from one on, because entries of the reference that the outputs lack are zero.
        places = reference_in(kernel, np.arange(1.0, size + 1.0)).astype(np.int64) - 1
        is_relative = "pose" in rows or ("x" in rows and len(system.space.balls) > 0)
        self._reference = places if is_relative else places[:0]

    def __call__(self, back: OutputCovectors) -> None:
        """Compute the derivatives of Σ covectors · rows."""
        argument, reference = np.zeros(self._argument_size), self._reference
        slopes = np.empty(len(argument) + len(back[3]))
        addresses = (self._outputs.address, self._outcome.adjoint.address)
        outputs = np.empty(self._output_size)
        _propagate_covectors(addresses, self._size, reference, back, argument, outputs, slopes)


@compiled
def _propagate_covectors(
    addresses: tuple[int, int],
    size: int,
    reference: Indices,
    back: OutputCovectors,
    argument: Array,
    out: Array,
    slopes: Array,
) -> None:
    """Propagate the covectors of OutcomeAdjoint backwards, time by time.

    addresses: addresses of the kernel's output function and of its adjoint.
    size: length of y.
    reference: index in the outputs of each entry of the reference, −1 for entries that remain zero;
        empty if no covector needs the reference.
    argument: work space for (y, t, reference); the output function reads only y and t.
    out, slopes: work space for the outputs and for the derivatives at one time.
    """
    begin, times, y, constants, covectors, at_times, by_constants = back
    argument_size = argument.shape[0]
    for j in range(times.shape[0]):
        for k in range(size):
            argument[k] = y[j, k]
        argument[size] = begin + times[j]
        if reference.shape[0] > 0:
            call(addresses[0], argument, constants, out)
            for k in range(reference.shape[0]):
                if reference[k] >= 0:
                    argument[size + 1 + k] = out[reference[k]]
        call_adjoint(addresses[1], argument, constants, covectors[j], slopes)
        for k in range(size):
            at_times[j, k] = slopes[k]
        for k in range(constants.shape[0]):
            by_constants[k] += slopes[argument_size + k]
