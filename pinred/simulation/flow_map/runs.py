"""The course of a flow map: its runs from stop to stop, along directions, and back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...common.arrays import Array, read_only
from ...common.errors import InputError, IntegrationError
from ...integrators.integrate import Solution, integrate_checked
from ...integrators.methods import AdaptiveGauss, Explicit
from ...integrators.run_derivatives import Slopes, refuse_without_derivatives, run_along, run_back
from ...kernels.differentiable import call_value
from ...kernels.evaluate import evaluate
from ...kernels.flow_functions import Row, initial_conditions_of, outcome_of, rate_of, sizes_of
from ...kernels.initial_conditions import TwistOrMomentum
from ...kernels.tangent import tangent_of
from ...system.state_fields import ShapeState, State
from ..compiled.compiled_flow import CompiledFlow, rate_address
from ..compiled.integrator import explained, wild_steps
from ..compiled.kernel_of_plan import kernel_of
from ..pieces import joined
from ..plan import Plan
from .inputs import Given, motion_of
from .later import made_later
from .outcomes_back import OutcomesBack
from .prepared import Prepared, Ran

OVERFLOWS = "the initial momentum or twist overflows: rates or momentum too large"


@dataclass(frozen=True)
class Stretch:
    """A run of the integrator between two stops.

    begin: its time [s].  times: (T,) of reports from there on [s].  parameters: (p,).
    """

    begin: float
    times: Array
    parameters: Array
    ran: Ran | Solution

    @property
    def solution(self) -> Solution:
        """The run, as `integrate` gives it."""
        return self.ran if isinstance(self.ran, Solution) else self.ran.solution


@dataclass(frozen=True)
class Run:
    """The stretches of a run, and what it began with.  line: (3k,), as in CompiledFlow."""

    given: Given
    stretches: list[Stretch]
    line: Array


class Course:
    """What all runs of a flow map share: kernel, method, stops."""

    def __init__(self, plan: Plan, *, zero_momentum: bool) -> None:
        """Make the kernels ready.  Raises InputError for what has no derivatives."""
        self.plan, self.method, self.zero_momentum = plan, plan.method, zero_momentum
        if plan.forces is not None and plan.forces.held:
            controller, _ = plan.forces.held[0]
            raise InputError(
                f"{controller.name} is a function of Python, which has no derivatives; write it as "
                "a Torque of CasADi expressions, or use simulate"
            )
        if plan.scene.events_given:
            raise InputError("a flow map looks for no events; use simulate for them")
        refuse_without_derivatives(self.method)
        self.kernel = kernel = kernel_of(plan, zero_momentum=zero_momentum, generic=True)
        motion: TwistOrMomentum = "mu" if motion_of(plan.scene) == "mu" else "xi"
        self._begin = initial_conditions_of(kernel, motion)
        self._rate = rate_of(kernel)
        self._address = rate_address(kernel, self.method)
        rate = self._rate
        self._slopes = Slopes(
            tangent=lambda: rate.tangent.address,
            adjoint=lambda: rate.adjoint.address,
            tangents=lambda count: rate.wide_tangent(count).address,
            adjoints=lambda count: rate.wide_adjoint(count).address,
        )
        layout, k = kernel.layout, plan.system.group.linear
        self._clock, self._wanted = layout.clock, layout.base_requested
        self._numbers, self._path = max(layout.size, 1), layout.com_path_at
        self._backs: dict[tuple[Row, ...], OutcomesBack] = {}
        self._sizes = [layout.size, layout.gravity_at, 2 * k]
        self._falls = k
        asked, begins = plan.scene.report_times, np.append(0.0, plan.stops[:-1])
        self._stretches: list[tuple[float, float, Array]] = []
        for begin, stop in zip(begins, plan.stops, strict=True):
            # Where one ends, the next begins only after it, as in Motion.
            inside = (asked > begin) & (asked <= stop) | ((asked == 0.0) & (begin == 0.0))
            self._stretches.append((float(begin), float(stop), read_only(asked[inside] - begin)))
        self._begun, self._begin_at = sum(self._sizes), self._begin.value.address
        self._ready = None
        if isinstance(self.method, (Explicit, AdaptiveGauss)) and len(self._stretches) == 1:
            (_, stop, times), n = self._stretches[0], max(layout.size, 1)
            self._ready = Prepared(
                self.method, self._address, n, stop, times, layout.quaternion, layout.canonical
            )

    def run(self, given: Given, *, stages: bool = False) -> Run:
        """Return the run that begins as given.  Raises IntegrationError.

        stages: whether those of its steps are to be kept, where that can be, for the way back.
        """
        constants, fall = self._apart(given.constants)
        out = np.empty(self._begun)
        known = self._with_line(constants, None)
        call_value(self._begin_at, given.state, known, out)
        if not np.isfinite(out).all():
            raise InputError(OVERFLOWS)
        n, head = self._sizes[0], self._sizes[0] + self._sizes[1]
        y, line = out[:n] if n else np.zeros(1), np.concatenate([out[head:], fall])
        parameters = np.concatenate([out[n:head], self._with_line(constants, line)])
        if self._ready is not None:
            ((begin, stop, times),) = self._stretches
            here = self._within(parameters, begin, stop)
            if (ran := self._ready(here, y, stages=stages)) is not None:
                return Run(given, [Stretch(begin, times, here, ran)], line)
        return self._run_all(given, y, parameters, line)

    def _run_all(self, given: Given, y: Array, parameters: Array, line: Array) -> Run:
        """Return the run from stop to stop."""
        kernel, layout, stretches = self.kernel, self.kernel.layout, []
        for begin, stop, times in self._stretches:
            here = self._within(parameters, begin, stop)
            try:
                solution = integrate_checked(
                    self.method, self._address, here, y, stop - begin, times, layout.quaternion,
                    None, lambda: tangent_of(kernel).address, layout.canonical,
                )  # fmt: skip
            except IntegrationError as stopped:
                at = CompiledFlow.made(kernel, y, here, line)
                raise explained(stopped, at, self.plan.scene, begin) from None
            if wild := wild_steps(kernel, self.plan, solution.states, solution.knots):
                raise IntegrationError(wild)
            if self._ready is not None:
                self._ready.make_room(solution.steps)
            stretches.append(Stretch(begin, times, here, solution))
            y = solution.states[-1].copy()
            if layout.quaternion >= 0 and self.method.lanes == 1:
                q = slice(layout.quaternion, layout.quaternion + 4)
                y[q] /= np.linalg.norm(y[q])
        return Run(given, stretches, line)

    def end(self, run: Run) -> State | ShapeState:
        """Return the full state at the end of a run; its fields are made when looked at."""
        part, size, clock = run.stretches[-1], self._sizes[0], self._clock
        time, where = part.begin + part.times[-1], self.kernel.where

        def outputs() -> Array:
            row = np.empty(size + 1 - clock)
            row[:size] = part.ran.y[-1, :size]
            if not clock:
                row[size] = time
            out = np.empty(where.size)
            rest = np.concatenate([part.parameters, run.line])
            call_value(self.kernel.outputs.address, row, rest, out)
            return out

        return made_later(self.plan.system, where, time, outputs, wanted=self._wanted)

    def states(self, run: Run) -> State | ShapeState:
        """Return the full states of a run at its times."""
        parts = [self._states(run, part) for part in run.stretches if part.times.size]
        return (
            parts[0]
            if len(parts) == 1
            else joined(parts, np.arange(len(self.plan.scene.report_times)))
        )

    def _states(self, run: Run, part: Stretch) -> State | ShapeState:
        flow = CompiledFlow.made(self.kernel, part.ran.y[:0], part.parameters, run.line)
        return flow.states(part.begin + part.times, part.ran.y, flow.numbers)

    def outputs(self, run: Run) -> Array:
        """Return the outputs (T, ·) of a run at its times; see Outputs for what stands where."""
        kernel = self.kernel
        parts = []
        for part in run.stretches:
            rows = part.ran.y[:, : kernel.layout.size]
            if not kernel.layout.clock:
                rows = np.concatenate([rows, (part.begin + part.times)[:, None]], axis=1)
            constants = np.concatenate([part.parameters, run.line])
            parts.append(evaluate(kernel.outputs.address, constants, rows, kernel.where.size))
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def along(self, run: Run, rows: tuple[Row, ...], state: Array, constants: Array) -> Array:
        """Return the derivatives (T, rows, N) along directions of what the run began with."""
        kernel = self.kernel
        constants, fall = self._apart(constants)
        own, known = self._known(run.given), self._with_line(constants, None)
        found = self._begin.forward(run.given.state, own, state, known, sum(self._sizes))
        moved, head, start = np.split(found, np.cumsum(self._sizes[:2]))
        moved = moved if len(moved) else np.zeros((1, state.shape[1]))
        line = np.vstack([start, fall])
        parameters = np.vstack([head, self._with_line(constants, line)])
        outcome, out = outcome_of(kernel, rows), []
        for part in run.stretches:
            done = run_along(
                self.method, self._address, self._slopes, part.parameters,
                part.solution.states[0], part.solution.knots, part.times, kernel.layout.quaternion,
                moved, parameters, part.solution.states,
            )  # fmt: skip
            moved = done.end_slopes
            for at, slopes in zip(self._ends(run, part), done.slopes, strict=True):
                a = np.zeros((len(at[0]), state.shape[1]))
                a[: kernel.layout.size] = slopes[: kernel.layout.size]
                count = self._count(rows)
                out.append(outcome.forward(*at, a, np.vstack([parameters, line]), count))
        return np.array(out)

    def back(self, run: Run, rows: tuple[Row, ...], covectors: Array) -> tuple[Array, Array]:
        """Return the slopes of Σ covectors · rows by the state and constants a run began with.

        covectors: (T, rows).
        """
        kernel, layout = self.kernel, self.kernel.layout
        back = self._backs.get(rows)
        if back is None:
            back = self._backs[rows] = OutcomesBack(kernel, rows)
        p, head, at = layout.parameters, self._sizes[1], self._path
        by_rest = np.zeros(p + len(run.line))
        covector, k = np.zeros(self._numbers), len(covectors)
        for part in reversed(run.stretches):
            k -= len(part.times)
            at_times = np.zeros((len(part.times), self._numbers))
            if len(part.times):
                constants = np.concatenate([part.parameters, run.line])
                some = covectors[k : k + len(part.times)]
                back(part.begin, part.times, part.ran.y, constants, some, at_times, by_rest)
            done = run_back(
                self.method, self._address, self._slopes, part.parameters, part.ran, part.times,
                layout.quaternion, covector, at_times,
            )  # fmt: skip
            covector = done.by_state
            by_rest[:p] += done.by_parameters
        by_line = by_rest[p:]
        if layout.com_path:
            by_line += by_rest[at : at + layout.com_path]
        ends_of_begin = np.concatenate(
            [covector[: layout.size], by_rest[:head], by_line[: self._sizes[2]]]
        )
        state, constants = self._begin.reverse(
            run.given.state, self._known(run.given), ends_of_begin
        )
        constants += by_rest[head:p]
        if layout.com_path:
            constants = np.delete(constants, np.s_[at - head : at - head + layout.com_path])
        return state, np.concatenate([constants, by_line[self._sizes[2] :]])

    def _known(self, given: Given) -> Array:
        """Return the kernel's constants, of which the begin reads no path of the centre of mass."""
        return self._with_line(self._apart(given.constants)[0], None)

    def _with_line(self, constants: Array, line: Array | None) -> Array:
        """Return constants (…) with the path of the centre of mass where forces see that."""
        layout = self.kernel.layout
        if not layout.com_path:
            return constants
        at = layout.com_path_at - layout.gravity_at
        if line is None:
            line = np.zeros((layout.com_path, *constants.shape[1:]))
        return np.concatenate([constants[:at], line, constants[at:]])

    def _apart(self, constants: Array) -> tuple[Array, Array]:
        """Return the kernel's constants, and how the centre of mass falls."""
        at = len(constants) - self._falls
        return constants[:at], constants[at:]

    def one_step(
        self,
        given: Given,
        h: float,
        t: float,
        rows: tuple[Row, ...],
        columns: tuple[Array, Array] | None,
    ) -> tuple[State | ShapeState, Array]:
        """Return the state after one step from time t, and slopes (rows, N).

        columns: (…, N) directions of state and constants, if slopes are wanted.
        Raises InputError where the step goes over a break, and IntegrationError.
        """
        kernel, layout, plan = self.kernel, self.kernel.layout, self.plan
        self._check_step(t, h)
        own, fall = self._apart(given.constants)
        state, constants = columns or (
            np.zeros((len(each), 0)) for each in (given.state, given.constants)
        )
        constants, fall_along = self._apart(constants)
        known, known_along = self._with_line(own, None), self._with_line(constants, None)
        out = self._begin.at(given.state, known, sum(self._sizes))
        along = self._begin.forward(given.state, known, state, known_along, sum(self._sizes))
        cuts = np.cumsum(self._sizes[:2])
        (y, head, start), (moved, heads, starts) = np.split(out, cuts), np.split(along, cuts)
        if not np.isfinite(out).all():
            raise InputError("the momentum or twist overflows: rates or momentum too large")
        if layout.clock:
            y[-1] = t
        # The centre of mass is where it is at time t.
        line = _from(t, np.concatenate([start, fall]), self._falls)
        lines = _from(t, np.vstack([starts, fall_along]), self._falls)
        parameters = np.concatenate([head, self._with_line(own, line)])
        parameters = self._within(parameters, t, t + h)
        y, moved = (y, moved) if y.size else (np.zeros(1), np.zeros((1, state.shape[1])))
        directions = np.vstack([heads, self._with_line(constants, lines)])
        knots = np.array([0.0, h])
        done = run_along(
            self.method, self._address, self._slopes, parameters, y, knots, knots[1:],
            layout.quaternion, moved, directions,
        )  # fmt: skip
        if not np.isfinite(done.y).all():
            raise IntegrationError(
                f"a step of {h:g} s of '{plan.system.name}' is not finite: take shorter ones"
            )
        at = np.zeros(layout.size + 1 + plan.system.group.size)
        at[: layout.size], at[layout.size] = done.y[0, : layout.size], t + h
        rest = np.concatenate([parameters, line])
        out = np.empty(kernel.where.size)
        call_value(kernel.outputs.address, at[: layout.size + 1 - layout.clock], rest, out)
        end = made_later(plan.system, kernel.where, t + h, lambda: out, wanted=self._wanted)
        if columns is None:
            return end, np.zeros((0, 0))
        at[layout.size + 1 :] = out[kernel.where.fields["pose"]]
        a = np.zeros((len(at), state.shape[1]))
        a[: layout.size] = done.slopes[0][: layout.size]
        along_rest = np.vstack([directions, lines])
        return end, outcome_of(kernel, rows).forward(at, rest, a, along_rest, self._count(rows))

    def _check_step(self, t: float, h: float) -> None:
        plan = self.plan
        if not (np.isfinite(t) and t >= 0.0 and t + h <= plan.scene.end * (1.0 + 1e-12)):
            raise InputError(
                f"a step of {h:g} s from t = {t:g} s is not within the scene's {plan.scene.end:g} s"
            )
        inside = plan.stops[(plan.stops > t + 1e-12) & (plan.stops < t + h - 1e-12)]
        if inside.size:
            raise InputError(
                f"a function of time is not smooth at t = {inside[0]:g} s, within the step of "
                f"{h:g} s from {t:g} s; let steps end there"
            )
        if t and plan.acting.driven:
            raise InputError("a step of a scene with prescribed joints begins at t = 0")

    def _ends(self, run: Run, part: Stretch) -> list[tuple[Array, Array]]:
        """Return the arguments (a, b) of the outcome at each time of a stretch."""
        if not part.times.size:
            return []
        kernel, where, t = self.kernel, self.kernel.where, part.begin + part.times
        size, clock = self._sizes[0], self._clock
        constants = np.concatenate([part.parameters, run.line])
        whole = np.empty((len(t), size + 1 + self.plan.system.group.size))
        whole[:, :size], whole[:, size] = part.ran.y[:, :size], t
        whole[:, size + 1 :] = 0.0
        if self._wanted:
            given = whole[:, : size + 1 - clock]
            out = evaluate(kernel.outputs.address, constants, given, where.size)
            whole[:, size + 1 :] = out[:, where.fields["pose"]]
        return [(row, constants) for row in whole]

    def _count(self, rows: tuple[Row, ...]) -> int:
        sizes = sizes_of(self.plan.system)
        return sum(sizes[row] for row in rows)

    def _within(self, parameters: Array, begin: float, stop: float) -> Array:
        """Return the parameters with the time in them that says which piece of tables counts."""
        forces, out = self.plan.forces, parameters.copy()
        if forces is not None and forces.within.stop > forces.within.start:
            first = len(out) - len(forces.numbers)
            out[first:][forces.within] = 0.5 * (begin + stop)
        return read_only(out)


def _from(t: float, line: Array, k: int) -> Array:
    """Return start, velocity and fall at time zero of what has these, (3k, …), at time t."""
    c, v, g = line[:k], line[k : 2 * k], line[2 * k :]
    return np.concatenate([c - t * v + 0.5 * t**2 * g, v - t * g, g])
