"""One evaluation of a flow: its start from inputs, its run, and the adjoints of both.

An InitialMap computes reduced state, parameters and centre-of-mass path from the inputs.  The steps
of a Run resolve functions of time.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from ...common.arrays import Array, read_only
from ...common.errors import AccuracyWarning, InputError
from ...forces.force_numbers import Tables
from ...integrators.integrate import Solution
from ...integrators.stepping.compiling import compiled
from ...integrators.stepping.intrinsics import call, call_adjoint
from ...kernels.build import expect_code
from ...kernels.flow_functions import (
    Row,
    initial_conditions_of,
    outcome_of,
    reference_in,
    reference_size,
)
from ...kernels.initial_conditions import TwistOrMomentum
from ...kernels.kernel import Kernel, call_value, evaluate
from ...system.coordinates import Indices
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


class InitialMap:
    """The map from input columns to reduced state, parameters and centre-of-mass path.

    The input columns are the fields of Given: `state` and `constants`, which end with the free-fall
    acceleration of the centre of mass.  A reduced state without entries is replaced by one zero,
    because integrators need at least one entry.
    """

    def __init__(self, kernel: Kernel, motion: TwistOrMomentum, tables: Tables | None) -> None:
        """Prepare the map.

        Args:
            kernel: Kernel of the flow.
            motion: Whether inputs have a body twist ("xi") or a body momentum ("mu").
            tables: Tables in the forces; None without forces.
        """
        self._tables = tables
        layout, k = kernel.layout, kernel.system.group.linear
        self._kernel, self._function = kernel, initial_conditions_of(kernel, motion)
        self._address = self._function.value.address
        self._cuts = [layout.size, layout.size + layout.gravity_at]
        self._size, self._fall = self._cuts[1] + 2 * k, k
        self._hole, self._path = layout.com_path_at - layout.gravity_at, layout.com_path

    def __call__(self, given: Given, t: float = 0.0) -> CompiledFlow:
        """Return the flow that starts from inputs.

        Args:
            given: The inputs.
            t: Start time [s]; the centre-of-mass path is stated at time zero.
        Returns:
            The flow.
        Raises:
            InputError: The momentum or twist overflows.
        """
        constants, fall = self._split(given.constants)
        outputs = np.empty(self._size)
        call_value(self._address, given.state, self._with_path(constants, None), outputs)
        _refuse_overflow(outputs)
        y, head, start = self._pieces(outputs)
        path = _moved_back(t, np.concatenate([start, fall]), self._fall)
        parameters = np.concatenate([head, self._with_path(constants, path)])
        y0 = y if y.size else np.zeros(1)
        return CompiledFlow(self._kernel, self._tables, y0, parameters, path)

    def of_many(self, states: Array, constants: Array) -> CompiledFlow:
        """Return the flow of N inputs, rows of states and constants.  Raises InputError."""
        other_constants, falls = self._split(constants.T)
        kernel_constants = np.ascontiguousarray(self._with_path(other_constants, None).T)
        outputs = evaluate(self._address, kernel_constants, states, self._size)
        _refuse_overflow(outputs)
        y, head, start = self._pieces(outputs.T)
        path = np.vstack([start, falls])
        parameters = np.vstack([head, self._with_path(other_constants, path)])
        columns = (np.ascontiguousarray(each.T) for each in (y, parameters, path))
        return CompiledFlow(self._kernel, self._tables, *columns)

    def along_many(
        self, states: Array, constants: Array, directions: tuple[Array, Array]
    ) -> tuple[Array, Array, Array]:
        """Return derivatives of the flow of N inputs along D directions of each.

        Args:
            states: States of the inputs, (N, …).
            constants: Constants of the inputs, (N, …).
            directions: Directions of both, (N, …, D), or (1, …, D) for all inputs.
        Returns:
            Derivatives of the reduced states (N, n, D), the parameters (N, p, D) and the paths
            (N, 3k, D).
        """
        by_state, by_constants = directions
        # The entries come first here, as in `along`.
        known, falls = self._split(np.moveaxis(by_constants, 0, 1))
        points = self._with_path(self._split(constants.T)[0], None).T
        derivatives = self._function.forward_many(
            states, points, by_state, np.moveaxis(self._with_path(known, None), 1, 0), self._size
        )
        y, head, start = self._pieces(np.moveaxis(derivatives, 0, 1))
        shape = (len(states), by_state.shape[2])
        known, falls = (np.broadcast_to(a, (len(a), *shape)) for a in (known, falls))
        path = np.concatenate([start, falls])
        parameters = np.concatenate([head, self._with_path(known, path)])
        y = y if len(y) else np.zeros((1, *shape))
        return np.moveaxis(y, 0, 1), np.moveaxis(parameters, 0, 1), np.moveaxis(path, 0, 1)

    def expect_along(self) -> None:
        """Let other threads generate the machine code of `along`."""
        expect_code(lambda: self._function.tangent)

    def expect_back(self) -> None:
        """Let other threads generate the machine code of `back`."""
        expect_code(lambda: self._function.adjoint)

    def along(
        self, given: Given, state: Array, constants: Array, t: float = 0.0
    ) -> tuple[Array, Array, Array]:
        """Return derivatives along N directions of the inputs.

        Args:
            given: The inputs.
            state: Directions of the inputs' state, (…, N).
            constants: Directions of the inputs' constants, (…, N).
            t: Start time [s].
        Returns:
            Derivatives of the reduced state (n, N), the parameters (p, N) and the path (3k, N).
        """
        constants, falls = self._split(constants)
        kernel_constants, directions = self._known(given), self._with_path(constants, None)
        derivatives = self._function.forward(
            given.state, kernel_constants, state, directions, self._size
        )
        y, head, start = self._pieces(derivatives)
        path = _moved_back(t, np.vstack([start, falls]), self._fall)
        parameters = np.vstack([head, self._with_path(constants, path)])
        return y if len(y) else np.zeros((1, state.shape[1])), parameters, path

    def back(
        self, given: Given, by_y: Array, by_parameters: Array, by_path: Array
    ) -> tuple[Array, Array]:
        """Return the cotangents of the inputs' state and constants.

        Args:
            given: The inputs.
            by_y: Cotangent of the reduced state, (n,).
            by_parameters: Cotangent of the parameters, (p,).
            by_path: Cotangent of the path, (3k,).
        Returns:
            Cotangents of `state` and of `constants`.
        """
        size, head = self._cuts[0], self._cuts[1] - self._cuts[0]
        if self._path:
            first = head + self._hole
            by_path = by_path.copy()
            by_path[: self._path] += by_parameters[first : first + self._path]
        starts = len(by_path) - self._fall
        covector = np.concatenate([by_y[:size], by_parameters[:head], by_path[:starts]])
        state, constants = self._function.reverse(given.state, self._known(given), covector)
        constants += by_parameters[head:]
        if self._path:
            constants = np.delete(constants, np.s_[self._hole : self._hole + self._path])
        return state, np.concatenate([constants, by_path[starts:]])

    def _pieces(self, out: Array) -> tuple[Array, Array, Array]:
        """Split outputs into reduced state, first parameters, and position and velocity."""
        first, second = self._cuts
        return out[:first], out[first:second], out[second:]

    def _known(self, given: Given) -> Array:
        return self._with_path(self._split(given.constants)[0], None)

    def _with_path(self, constants: Array, path: Array | None) -> Array:
        """Insert the path into the constants if forces depend on the path; None inserts zeros."""
        if not self._path:
            return constants
        if path is None:
            path = np.zeros((self._path, *constants.shape[1:]))
        return np.concatenate([constants[: self._hole], path, constants[self._hole :]])

    def _split(self, constants: Array) -> tuple[Array, Array]:
        """Split input constants into the kernel's constants and the free-fall acceleration."""
        at = len(constants) - self._fall
        return constants[:at], constants[at:]


def _refuse_overflow(out: Array) -> None:
    if not np.isfinite(out).all():
        raise InputError("the initial momentum or twist overflows; reduce rates or momentum")


def _moved_back(t: float, path: Array, k: int) -> Array:
    """Return the path (3k, …), stated at time zero, from its position and velocity at time t."""
    if t == 0.0:
        return path
    start, velocity, fall = path[:k], path[k : 2 * k], path[2 * k :]
    return np.concatenate([start - t * velocity + 0.5 * t**2 * fall, velocity - t * fall, fall])


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
