"""Propagator: initial reduced state, values of a flow map from stop to stop, tangents, and adjoint.

Other threads generate the machine code of the derivatives while the flow is integrated.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ...common.arrays import Array, read_only
from ...common.errors import AccuracyWarning, InputError, IntegrationError
from ...forces.switch_times import time_within
from ...integrators.integrate import Integration, Solution
from ...integrators.methods import Explicit, Method
from ...integrators.run_derivatives import (
    SmoothField,
    refuse_without_derivatives,
    run_along,
    run_back,
)
from ...kernels.build import expect_code, tangent_of
from ...kernels.flow_functions import Row, outcome_of, rate_of, reference_in, sizes_of
from ...kernels.kernel import Outputs, call_in_batches, call_value, evaluate, in_given_order
from ...system.coordinates import Indices
from ...system.state_fields import Outcome, ShapeState, State, arrays_of, map_arrays
from ...system.system import System
from ..compiled.code_ahead import expect, expect_cotangents, expect_tangents
from ..compiled.compiled_flow import CompiledFlow, kernel_of, rate_address
from ..compiled.integrator import explained, wild_steps
from ..members.integrate_members import integrate_members
from ..members.trajectories import Batch
from ..plan import Plan, Span, spans_between
from .inputs import Given, InitialMap, motion_of
from .jumps import jumps_of
from .run_and_adjoint import OutcomeAdjoint, Run, resolve_run

_NUMBERS_AT_ONCE = 2**24  # largest number of derivatives that are kept at once


class _ReadOnAccess:
    """A state whose fields are computed by `read` at first access and then cached."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    def __init__(self, read: Callable[[str], Array]) -> None:
        vars(self)["_read"] = read

    def __getattr__(self, name: str) -> Any:
        if name not in self.__dataclass_fields__ or "_read" not in vars(self):
            raise AttributeError(name)
        value = vars(self)[name] = read_only(vars(self)["_read"](name))
        return value


class LazyState(_ReadOnAccess, State):
    """A State whose fields are computed at first access."""

    def __reduce__(self) -> tuple[Any, ...]:
        return State, tuple(arrays_of(self).values())


class LazyShapeState(_ReadOnAccess, ShapeState):
    """A ShapeState whose fields are computed at first access."""

    def __reduce__(self) -> tuple[Any, ...]:
        return ShapeState, tuple(arrays_of(self).values())


def lazy_state(
    system: System, where: Outputs, t: float, outputs: Callable[[], Array], *, wanted: bool
) -> State | ShapeState:
    """Return the state at one time whose fields are computed at first access.

    Args:
        system: The system of the kernel.
        where: Slices of the outputs.
        t: Time [s].
        outputs: Function that computes the kernel's outputs, (where.size,); called once.
        wanted: Whether the scene requests the base, so that the outputs contain it.
    Returns:
        A State with the base, a ShapeState without it.
    """
    computed: list[Array] = []

    def read(name: str) -> Array:
        if name == "t":
            return np.array(t)
        if not computed:
            computed.append(outputs())
        return in_given_order(name, computed[0][..., where.fields[name]], system)

    return LazyState(read) if wanted else LazyShapeState(read)


class Propagator:
    """The kernels and the integration that all evaluations of a flow map share.

    Attributes:
        plan: The plan of the scene.
        method: Integrator.
        zero_momentum: Whether the angular momentum is zero for all inputs.
        kernel: Machine code and layout.
        field: Addresses of the vector field and of its derivatives.
    """

    def __init__(self, plan: Plan, *, zero_momentum: bool) -> None:
        """Prepare the kernels.  Raises InputError if the scene or its method has no derivatives."""
        self.plan, self.method, self.zero_momentum = plan, plan.method, zero_momentum
        if plan.forces is not None and plan.forces.held:
            controller, _ = plan.forces.held[0]
            raise InputError(
                f"{controller.name} is a Python function, which has no derivatives; write it as "
                "a Torque of CasADi expressions, or use simulate"
            )
        if plan.scene.events_given:
            raise InputError(
                "events: a flow ends at a fixed time and does not detect events. Use simulate; "
                "docs/flow.md shows how to get derivatives at a terminal event"
            )
        refuse_without_derivatives(self.method)
        self.kernel = kernel = kernel_of(plan, zero_momentum=zero_momentum, generic=True)
        rate, layout = rate_of(kernel), kernel.layout
        self.field = SmoothField(
            address=rate_address(kernel, self.method),
            quaternions=layout.quaternions,
            tangent=lambda: rate.tangent.address,
            pair=lambda: rate.pair.address,
            adjoint=lambda: rate.adjoint.address,
            tangents=lambda count: rate.wide_tangent(count).address,
            adjoints=lambda count: rate.wide_adjoint(count).address,
        )
        self._n = max(layout.size, 1)
        self._backs: dict[tuple[Row, ...], OutcomeAdjoint] = {}
        self._integrations = [self._integration(span) for span in plan.spans]

    @cached_property
    def initial(self) -> InitialMap:
        """The map from the inputs to the initial reduced state."""
        plan = self.plan
        tables = None if plan.forces is None else plan.forces.tables
        return InitialMap(self.kernel, motion_of(plan.scene), tables)

    def _integration(self, span: Span, method: Method | None = None) -> Integration:
        """Prepare the integration over one span, with another longest step if a method is given."""
        kernel, layout = self.kernel, self.kernel.layout
        return Integration(
            method or self.method, self.field.address, self._n, span.stop - span.start, span.times,
            layout.quaternions, kernel.canonical, lambda: tangent_of(kernel).address,
        )  # fmt: skip

    def _spans_of(self, flow: CompiledFlow) -> tuple[list[Span], list[Integration]]:
        """Return the spans of a run with their integrations: the scene's, unless stops vary."""
        plan = self.plan
        if not plan.stops_vary:
            return plan.spans, self._integrations
        (stops,) = plan.stops_of_runs(flow.numbers[None])
        spans = spans_between(stops, plan.scene.report_times)
        return spans, [self._integration(span) for span in spans]

    def run(self, given: Given, *, stages: bool = False) -> Run:
        """Integrate the flow from inputs.

        Args:
            given: The inputs.
            stages: Whether to store stage derivatives for the backward pass.
        Returns:
            The evaluation.
        Raises:
            InputError: The initial momentum or twist overflows.
            IntegrationError: The integrator cannot continue.
        """
        flow, reports = self.initial(given), self.plan.scene.report_times
        spans, integrations = self._spans_of(flow)
        resolves = self.plan.has_time_functions
        if not (resolves and self.method.adaptive):
            solutions = self._solve(flow, spans, integrations, stages=stages)
            if resolves:
                for notice in self.plan.notices_of_equal_steps(flow.numbers):
                    warnings.warn(notice, AccuracyWarning, stacklevel=4)
            return Run(given, flow, spans, solutions)

        def solve(plan: Plan) -> tuple[list[Span], list[Solution]]:
            spans = spans_between(plan.stops, reports)
            method: Any = self.method
            method = replace(method, max_step=min(method.max_step, plan.longest))
            integrations = [self._integration(span, method) for span in spans]
            return spans, self._solve(flow, spans, integrations, stages=stages)

        return Run(given, flow, *resolve_run(self.plan, flow, spans, solve))

    def _solve(
        self,
        flow: CompiledFlow,
        spans: list[Span],
        integrations: list[Integration],
        *,
        stages: bool,
    ) -> list[Solution]:
        """Return the solution over each span."""
        y, layout = flow.y0, self.kernel.layout
        solutions: list[Solution] = []
        for span, integrate in zip(spans, integrations, strict=True):
            if solutions:
                y = solutions[-1].states[-1].copy()
                first, count = layout.quaternions if self.method.lanes == 1 else (0, 0)
                for k in range(first, first + 4 * count, 4):
                    y[k : k + 4] /= np.linalg.norm(y[k : k + 4])
            parameters = read_only(flow.parameters_between(span.start, span.stop))
            try:
                solution = integrate(parameters, y, stages=stages)
            except IntegrationError as stop:
                raise explained(stop, flow, self.plan.scene, span.start, parameters) from None
            if not self.method.adaptive:
                wild = wild_steps(self.kernel, self.plan, solution.states, solution.knots)
                if wild:
                    raise IntegrationError(wild)
            solutions.append(solution)
        return solutions

    def solution(self, flow: CompiledFlow, span: Span, longest: float) -> Solution:
        """Return the solution over a span from the state of a flow, with its stages.

        Args:
            flow: The flow.
            span: The span.
            longest: Longest step [s], if forces depend on time.
        """
        method: Any = self.method
        if self.plan.has_time_functions and self.method.adaptive:
            method = replace(method, max_step=min(method.max_step, longest))
        return self._solve(flow, [span], [self._integration(span, method)], stages=True)[0]

    def end(self, run: Run) -> State | ShapeState:
        """Return the final full state of a run; its fields are computed at first access."""
        span, solution = run.spans[-1], run.solutions[-1]
        time = span.start + span.times[-1]
        return self._state(run.flow, time, solution.y[-1], solution.params)

    def states(self, run: Run) -> State | ShapeState:
        """Return the full states of a run at the report times."""
        states = [
            run.flow.states(span.start + span.times, solution.y, solution.params)
            for span, solution in self._reported(run)
        ]
        return map_arrays(_joined, *states) if len(states) > 1 else states[0]

    def outputs(self, run: Run) -> Array:
        """Return the kernel's outputs, (T, ·), at the report times."""
        rows = (
            run.flow.outputs(span.start + span.times, solution.y, solution.params)
            for span, solution in self._reported(run)
        )
        return _joined(*rows)

    def outputs_of_many(
        self, states: Array, constants: Array, threads: int | None, device: str | None = None
    ) -> Array:
        """Compute the kernel's outputs at many inputs, in SIMD lanes if the method supports lanes.

        The results agree with `outputs` within round-off times the growth along the flow.

        Args:
            states: State of the inputs, (N, …), as in Given.
            constants: Constants of the inputs, (N, …), as in Given.
            threads: Number of threads; as many as processors if None.
            device: "cuda" to integrate on CUDA devices, None for the CPU.
        Returns:
            (N, T, ·): the outputs at the report times.
        Raises:
            InputError: An initial momentum or twist overflows.
            IntegrationError: The integration of a member fails.
        """
        flow, count = self.initial.of_many(states, constants), len(states)
        batch = integrate_members(flow, self.plan, np.arange(count), threads, device=device)
        _refuse_failures(batch, count)
        outputs = self._outputs_at(*self._points(flow, batch.y))
        return outputs.reshape(count, -1, self.kernel.where.size)

    def jacobians(
        self,
        states: Array,
        constants: Array,
        directions: tuple[Array, Array],
        rows: tuple[Row, ...],
        threads: int | None,
        device: str | None,
    ) -> Array:
        """Compute derivatives of outputs at many inputs, each direction with a run of its own.

        Args:
            states: State of the inputs, (N, …), as in Given.
            constants: Constants of the inputs, (N, …), as in Given.
            directions: D directions of both, (N, …, D), or (1, …, D) for all inputs.
            rows: Names of the outputs.
            threads: Number of threads; as many as processors if None.
            device: "cuda" to integrate on CUDA devices, None for the CPU.
        Returns:
            (N, T, rows, D).
        Raises:
            InputError: An initial momentum or twist overflows.
            IntegrationError: The integration of a member fails, or a derivative is not finite.
        """
        N, D, T = len(states), directions[0].shape[2], len(self.plan.scene.report_times)
        most = max(1, _NUMBERS_AT_ONCE // (max(D, 1) * T * (2 * self._n + self._size(rows))))
        if most < N:
            parts = [slice(first, first + most) for first in range(0, N, most)]
            return np.concatenate([
                self.jacobians(
                    states[part], constants[part],
                    tuple(a if len(a) == 1 else a[part] for a in directions),  # type: ignore[arg-type]
                    rows, threads, device,
                )
                for part in parts
            ])  # fmt: skip
        if not D:
            return np.zeros((N, T, self._size(rows), 0))
        flow = self.initial.of_many(states, constants)
        y, parameters, path = self.initial.along_many(states, constants, directions)
        joined = CompiledFlow(
            self.kernel,
            flow.tables,
            _with_directions(flow.y0, y),
            _with_directions(flow.parameters, parameters),
            np.repeat(flow.path, D, axis=0),
        )
        batch = integrate_members(
            joined, self.plan, np.arange(N * D), threads, device=device, tangent=True
        )
        _refuse_failures(batch, N, D)
        both = batch.y.reshape(N, D, T, 2, -1)
        inputs, numbers = self._points(flow, both[:, 0, :, 0])
        outputs = self._outputs_at(inputs, numbers)
        layout = self.kernel.layout
        times = np.tile(self.plan.scene.report_times, N)[:, None]
        a = np.hstack([inputs[:, : layout.size], times, reference_in(self.kernel, outputs)])
        da = np.zeros((N * T, a.shape[1], D))
        tangents = np.moveaxis(both[:, :, :, 1], 1, 3)[:, :, : layout.size]
        da[:, : layout.size] = tangents.reshape(N * T, -1, D)
        db = np.repeat(np.concatenate([parameters, path], axis=1), T, axis=0)
        slopes = outcome_of(self.kernel, rows).forward_many(a, numbers, da, db, self._size(rows))
        return self._finite(slopes)[0].reshape(N, T, -1, D)

    def _points(self, flow: CompiledFlow, y: Array) -> tuple[Array, Array]:
        """Return the inputs of outputs, (N T, …), and their constants, of reduced states (N, T, ·).

        The inputs are the reduced state, and the time unless the state contains it.
        """
        layout, plan, (N, T, _) = self.kernel.layout, self.plan, y.shape
        inputs = y[:, :, : layout.size].reshape(N * T, layout.size)
        if not layout.clock:
            inputs = np.hstack([inputs, np.tile(plan.scene.report_times, N)[:, None]])
        parameters = np.repeat(flow.parameters, T, axis=0)
        if plan.forces is not None:
            runs = flow.numbers if plan.stops_vary else flow.numbers[:1]  # others have equal stops
            within = [
                time_within(span.start, span.stop)
                for stops in plan.stops_of_runs(runs)
                for span in spans_between(stops, plan.scene.report_times)
                for _ in range(len(span.times))
            ]
            numbers = parameters[:, flow.numbers_at]
            plan.forces.set_span(numbers, np.resize(within, N * T))
        return inputs, np.hstack([parameters, np.repeat(flow.path, T, axis=0)])

    def _outputs_at(self, inputs: Array, constants: Array) -> Array:
        """Return the kernel's outputs at the points of `_points`."""
        return evaluate(self.kernel.outputs.address, constants, inputs, self.kernel.where.size)

    def entries(self, rows: Iterable[Outcome]) -> Indices:
        """Return the indices, among the kernel's outputs, of fields of State."""
        where = self.kernel.where
        indices = np.arange(where.size)
        return np.concatenate([indices[where.fields[row]] for row in rows])

    def along(self, run: Run, rows: tuple[Row, ...], state: Array, constants: Array) -> Array:
        """Return derivatives of outputs along N directions of the inputs.

        Args:
            run: The evaluation.
            rows: Names of the outputs.
            state: Directions of the inputs' state, (…, N).
            constants: Directions of the inputs' constants, (…, N).
        Returns:
            (T, rows, N).
        Raises:
            IntegrationError: A derivative is not finite.
        """
        y, parameters, path = self.initial.along(run.given, state, constants)
        derivatives = list[Array]()
        jumps = jumps_of(self.kernel, self.plan, run.flow.numbers, run.spans, run.solutions)
        numbers = parameters[run.flow.numbers_at]
        for k, (span, solution) in enumerate(zip(run.spans, run.solutions, strict=True)):
            if k in jumps:
                y = y + np.outer(jumps[k].change, jumps[k].delay(numbers))
            y, part = self.along_span(run.flow, span, solution, rows, y, (parameters, path))
            derivatives += part
        return self._finite(np.array(derivatives))[0]

    def along_span(
        self,
        flow: CompiledFlow,
        span: Span,
        solution: Solution,
        rows: tuple[Row, ...],
        y: Array,
        constant: tuple[Array, Array],
    ) -> tuple[Array, list[Array]]:
        """Propagate N tangents over a span.

        Args:
            flow: The flow.
            span: The span.
            solution: Its solution.
            rows: Names of the outputs.
            y: Tangents of the state at its start, (n, N).
            constant: Tangents of the parameters, (p, N), and of the path, (3k, N).
        Returns:
            Tangents at its end, and of the outputs at each report time, (rows, N).
        """
        parameters, path = constant
        tangents = run_along(
            self.method, self.field, solution.params, solution.states[0], solution.knots,
            span.times, y, parameters, solution.states,
        )  # fmt: skip
        derivatives = list[Array]()
        if span.times.size:
            outcome, size = outcome_of(self.kernel, rows), self._size(rows)
            layout = self.kernel.layout
            b, b_along = np.concatenate([solution.params, flow.path]), np.vstack([parameters, path])
            points = self._outcome_points(flow, span, solution)
            for a, slopes in zip(points, tangents.slopes, strict=True):
                a_along = np.zeros((len(a), y.shape[1]))
                a_along[: layout.size] = slopes[: layout.size]
                derivatives.append(outcome.forward(a, b, a_along, b_along, size))
        return tangents.end_slopes, derivatives

    def back(self, run: Run, rows: tuple[Row, ...], covectors: Array) -> tuple[Array, ...]:
        """Return the cotangents of the inputs' state and constants.

        Args:
            run: The evaluation.
            rows: Names of the outputs.
            covectors: Cotangents of the outputs, (T, rows).
        Returns:
            Cotangents of `state` and of `constants`.
        Raises:
            IntegrationError: A derivative is not finite.
        """
        p = self.kernel.layout.parameters
        by_rest = np.zeros(p + len(run.flow.path))
        covector = np.zeros(self._n)
        jumps = jumps_of(self.kernel, self.plan, run.flow.numbers, run.spans, run.solutions)
        by_numbers = by_rest[:p][run.flow.numbers_at]
        for k in range(len(run.spans) - 1, -1, -1):
            span, solution = run.spans[k], run.solutions[k]
            weights = rows, covectors
            covector = self.back_span(run.flow, span, solution, weights, covector, by_rest)
            if k in jumps:
                by_numbers += (covector @ jumps[k].change) * jumps[k].only_slopes()
        return self._finite(*self.initial.back(run.given, covector, by_rest[:p], by_rest[p:]))

    def back_span(
        self,
        flow: CompiledFlow,
        span: Span,
        solution: Solution,
        weights: tuple[tuple[Row, ...], Array],
        covector: Array,
        by_rest: Array,
    ) -> Array:
        """Propagate a covector back over a span.

        Args:
            flow: The flow.
            span: The span.
            solution: Its solution.
            weights: Names of the outputs, and covectors of all report times, (T, rows).
            covector: Covector of the state at its end, (n,).
            by_rest: Cotangents of the parameters and of the path, to which those of the span are
                added, (p + 3k,).
        Returns:
            Covector at its start, (n,).
        """
        rows, covectors = weights
        adjoint = self._backs.get(rows)
        if adjoint is None:
            adjoint = self._backs[rows] = OutcomeAdjoint(self.kernel, rows)
        at_times = np.zeros((len(span.times), self._n))
        if len(span.times):
            constants = np.concatenate([solution.params, flow.path])
            own = covectors[span.rows]
            adjoint((span.start, span.times, solution.y, constants, own, at_times, by_rest))
        gradients = run_back(self.method, self.field, solution, span.times, covector, at_times)
        by_rest[: self.kernel.layout.parameters] += gradients.by_parameters
        return gradients.by_state

    def _finite(self, *derivatives: Array) -> tuple[Array, ...]:
        """Return derivatives.  Raises IntegrationError if one is not finite."""
        if not all(np.isfinite(part).all() for part in derivatives):
            raise IntegrationError(
                f"a derivative of the flow of '{self.kernel.system.name}' is not finite, although "
                "the motion is, as with a force such as 1/cosh(t), whose derivative is ∞/∞ where "
                "cosh overflows. Write the force so that no part of it overflows"
            )
        return derivatives

    def one_step(
        self,
        given: Given,
        h: float,
        t: float,
        rows: tuple[Row, ...],
        columns: tuple[Array, Array] | None,
    ) -> tuple[State | ShapeState, Array]:
        """Return the state after one step, and the derivatives of its outputs.

        Args:
            given: The inputs, with the state at the start of the step.
            h: Length of the step [s].
            t: Start time of the step [s].
            rows: Names of the outputs.
            columns: N directions of the inputs' state and constants, (…, N); None to skip
                derivatives.
        Returns:
            The state, and the derivatives, (rows, N).
        Raises:
            InputError: The step passes a time at which a force is not smooth.
            IntegrationError: The state is not finite.
        """
        kernel, layout = self.kernel, self.kernel.layout
        state, constants = columns or (
            np.zeros((len(a), 0)) for a in (given.state, given.constants)
        )
        flow = self.initial(given, t)
        self._check_step(t, h, flow.numbers)
        y_along, parameters_along, path_along = self.initial.along(given, state, constants, t)
        if layout.clock:
            flow.y0[layout.size - 1] = t
        parameters, knots = read_only(flow.parameters_between(t, t + h)), np.array([0.0, h])
        step = run_along(
            self.method, self.field, parameters, flow.y0, knots, knots[1:], y_along,
            parameters_along,
        )  # fmt: skip
        if not np.isfinite(step.y).all():
            raise IntegrationError(
                f"a step of {h:g} s of '{kernel.system.name}' is not finite; choose a shorter step"
            )
        end_state = self._state(flow, t + h, step.y[0], parameters)
        if columns is None or not isinstance(end_state, State):
            return end_state, np.zeros((0, 0))
        reference = [*[end_state.x] * bool(kernel.system.space.balls), end_state.pose]
        a = np.concatenate([step.y[0, : layout.size], [t + h], *reference])
        b = np.concatenate([parameters, flow.path])
        a_along = np.zeros((len(a), state.shape[1]))
        a_along[: layout.size] = step.slopes[0][: layout.size]
        b_along = np.vstack([parameters_along, path_along])
        return end_state, outcome_of(kernel, rows).forward(a, b, a_along, b_along, self._size(rows))

    def _state(
        self, flow: CompiledFlow, t: float, y: Array, parameters: Array
    ) -> State | ShapeState:
        """Return the full state at one time; its fields are computed at first access."""
        kernel, layout = self.kernel, self.kernel.layout

        def outputs() -> Array:
            row = np.empty(layout.size + 1 - layout.clock)
            row[: layout.size] = y[: layout.size]
            if not layout.clock:
                row[layout.size] = t
            column = np.empty(kernel.where.size)
            call_value(kernel.outputs.address, row, np.concatenate([parameters, flow.path]), column)
            return column

        return lazy_state(kernel.system, kernel.where, t, outputs, wanted=layout.base_requested)

    def _reported(self, run: Run) -> Iterator[tuple[Span, Solution]]:
        """Yield each span that contains report times, with its solution."""
        for span, solution in zip(run.spans, run.solutions, strict=True):
            if span.times.size:
                yield span, solution

    def _check_step(self, t: float, h: float, numbers: Array) -> None:
        plan = self.plan
        if not (np.isfinite(t) and t >= 0.0 and t + h <= plan.scene.end * (1.0 + 1e-12)):
            raise InputError(
                f"a step of {h:g} s from t = {t:g} s is not within the scene's {plan.scene.end:g} s"
            )
        (stops,) = plan.stops_of_runs(numbers[None])
        inside = stops[(stops > t + 1e-12) & (stops < t + h - 1e-12)]
        if inside.size:
            raise InputError(
                f"a function of time is not smooth at t = {inside[0]:g} s, within the step of "
                f"{h:g} s from {t:g} s; choose steps that end there"
            )
        if t and plan.driven:
            raise InputError("a step of a scene with prescribed joints begins at t = 0")

    def _outcome_points(self, flow: CompiledFlow, span: Span, solution: Solution) -> Array:
        """Return the outcome's arguments at report times: reduced state, time, reference."""
        t, kernel = span.start + span.times, self.kernel
        outputs = np.zeros((len(t), kernel.where.size))
        if kernel.layout.base_requested or kernel.system.space.balls:
            outputs = flow.outputs(t, solution.y, solution.params)
        y = solution.y[:, : kernel.layout.size]
        return np.hstack([y, t[:, None], reference_in(kernel, outputs)])

    def _size(self, rows: tuple[Row, ...]) -> int:
        sizes = sizes_of(self.plan.system)
        return sum(sizes[row] for row in rows)


def _with_directions(columns: Array, directions: Array) -> Array:
    """Append each of D directions (N, n, D) to rows (N, n): (N D, 2 n)."""
    N, n, D = directions.shape
    both = np.empty((N, D, 2, n))
    both[:, :, 0], both[:, :, 1] = columns[:, None], np.moveaxis(directions, 2, 1)
    return both.reshape(N * D, 2 * n)


def _refuse_failures(batch: Batch, count: int, runs: int = 1) -> None:
    """Raise IntegrationError if one of `count` members fails, each of which has several runs."""
    if batch.failures:
        failure = min(batch.failures, key=lambda failure: failure.member)
        raise IntegrationError(
            f"member {failure.member // runs} of {count} stopped at t = {failure.time:g} s: "
            f"{failure.reason}"
        )


def _joined(*parts: Array) -> Array:
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def expect_along(propagator: Propagator, rows: tuple[Row, ...], count: int) -> None:
    """Let other threads generate the machine code of Propagator.along.

    Args:
        propagator: The propagator.
        rows: Names of the outputs.
        count: Number of directions.
    """
    field, method = propagator.field, propagator.method
    outcome = outcome_of(propagator.kernel, rows)
    expect_tangents(method, count)
    column, matrix = np.empty(1), np.empty((1, 1))
    expect(call_in_batches, 1, column, column, *[matrix] * 6)
    if isinstance(method, Explicit):
        expect_code(field.pair if count == 1 else field.tangent)
    else:
        expect_code(lambda: field.tangents(method.lanes))
    propagator.initial.expect_along()
    expect_code(lambda: outcome.value)
    expect_code(lambda: outcome.tangent)


def expect_back(propagator: Propagator, rows: tuple[Row, ...]) -> None:
    """Let other threads generate the machine code of Propagator.back.

    Args:
        propagator: The propagator.
        rows: Names of the outputs.
    """
    field, method = propagator.field, propagator.method
    outcome = outcome_of(propagator.kernel, rows)
    expect_cotangents(method)
    expect_code(lambda: outcome.value)
    expect_code(lambda: outcome.adjoint)
    if isinstance(method, Explicit):
        expect_code(field.adjoint)
    else:
        expect_code(lambda: field.adjoints(method.lanes))
    propagator.initial.expect_back()
