"""The course of a flow map: its runs from stop to stop, along directions, and back."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...common.arrays import Array, read_only
from ...common.errors import InputError, IntegrationError
from ...integrators.derivatives import Slopes, refuse_without_derivatives, run_along, run_back
from ...integrators.integrate import Solution, integrate_checked
from ...integrators.integrate_many import STATUS
from ...kernels.begin_and_end import Outcome, begin_of, outcome_of, rate_of, sizes_of
from ...kernels.evaluate import evaluate, evaluate_each
from ...kernels.start_kernel import TwistOrMomentum
from ...kernels.tangent import tangent_of
from ...reduction.base_parts import root_of
from ...system.system import Indices
from ..compiled.compiled_flow import CompiledFlow, rate_address
from ..compiled.integrator import explained, runs_of_members, wild_steps
from ..compiled.kernel_of_plan import kernel_of
from ..pieces import joined
from ..plan import Plan
from ..state import ShapeState, State
from .inputs import Given, motion_of

_OVERFLOWS = "the initial momentum or twist overflows: rates or momentum too large"


@dataclass(frozen=True)
class Stretch:
    """A run of the integrator between two stops.

    begin: its time [s].  times: (T,) of reports from there on [s].  parameters: (p,).
    """

    begin: float
    times: Array
    parameters: Array
    solution: Solution


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
        self._plan, self.method = plan, plan.method
        if plan.forces is not None and plan.forces.held:
            controller, _ = plan.forces.held[0]
            raise InputError(
                f"{controller.name} is a function of Python, which has no derivatives; write it as "
                "a Torque of CasADi expressions, or use simulate"
            )
        if plan.forces is not None and plan.forces.sees_place:
            raise InputError(
                "a force sees where the base is or how fast it moves, which maps of flows do not "
                "know; one that sees the attitude alone is no trouble, or use simulate"
            )
        if plan.scene.events_given:
            raise InputError("a flow map looks for no events; use simulate for them")
        refuse_without_derivatives(self.method)
        self.kernel = kernel = kernel_of(plan, zero_momentum=zero_momentum)
        motion: TwistOrMomentum = "mu" if motion_of(plan.scene) == "mu" else "xi"
        self._begin = begin_of(kernel, motion)
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
        self._sizes = [layout.size, layout.gravity_at, 2 * k]
        self._fall = root_of(plan.system).g
        asked, begins = plan.scene.report_times, np.append(0.0, plan.stops[:-1])
        self._stretches = []
        for begin, stop in zip(begins, plan.stops, strict=True):
            # Where one ends, the next begins only after it, as in Motion.
            inside = (asked > begin) & (asked <= stop) | ((asked == 0.0) & (begin == 0.0))
            self._stretches.append((float(begin), float(stop), read_only(asked[inside] - begin)))

    def run(self, given: Given) -> Run:
        """Return the run that begins as given.  Raises IntegrationError."""
        kernel, layout = self.kernel, self.kernel.layout
        out = self._begin.at(given.state, given.constants, sum(self._sizes))
        y, head, start = np.split(out, np.cumsum(self._sizes[:2]))
        parameters = np.concatenate([head, given.constants])
        line = np.concatenate([start, self._fall])
        if not np.isfinite(out).all():
            raise InputError(_OVERFLOWS)
        y = y if y.size else np.zeros(1)
        stretches = []
        for begin, stop, times in self._stretches:
            here = self._within(parameters, begin, stop)
            try:
                solution = integrate_checked(
                    self.method, self._address, here, y, stop - begin, times, layout.quaternion,
                    None, lambda: tangent_of(kernel).address, layout.canonical,
                )  # fmt: skip
            except IntegrationError as stopped:
                at = CompiledFlow.made(kernel, y, here, line)
                raise explained(stopped, at, self._plan.scene, begin) from None
            if wild := wild_steps(kernel, self._plan, solution.states, solution.knots):
                raise IntegrationError(wild)
            stretches.append(Stretch(begin, times, here, solution))
            y = solution.states[-1].copy()
            if layout.quaternion >= 0 and self.method.lanes == 1:
                q = slice(layout.quaternion, layout.quaternion + 4)
                y[q] /= np.linalg.norm(y[q])
        return Run(given, stretches, line)

    def states(self, run: Run) -> State | ShapeState:
        """Return the full states of a run at its times."""
        parts = [self._states(run, part) for part in run.stretches if part.times.size]
        return (
            parts[0]
            if len(parts) == 1
            else joined(parts, np.arange(len(self._plan.scene.report_times)))
        )

    def _states(self, run: Run, part: Stretch) -> State | ShapeState:
        flow = CompiledFlow.made(self.kernel, part.solution.y[:0], part.parameters, run.line)
        return flow.states(part.begin + part.times, part.solution.y, flow.numbers)

    def outputs(self, run: Run) -> Array:
        """Return the outputs (T, ·) of a run at its times; see Outputs for what stands where."""
        kernel = self.kernel
        parts = []
        for part in run.stretches:
            rows = part.solution.y[:, : kernel.layout.size]
            if not kernel.layout.clock:
                rows = np.concatenate([rows, (part.begin + part.times)[:, None]], axis=1)
            constants = np.concatenate([part.parameters, run.line])
            parts.append(evaluate(kernel.outputs.address, constants, rows, kernel.where.size))
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def entries(self, rows: Iterable[Outcome]) -> Indices:
        """Return where fields of State stand in the outputs of the kernel."""
        where, r = self.kernel.where, self._plan.system.r
        places = {
            "x": where.x,
            "xdot": where.xdot,
            "pose": where.pose,
            "xi": slice(where.v.start, where.v.start + r),
            "body_momentum": where.body_momentum,
            "spatial_momentum": where.spatial_momentum,
            "energy": slice(where.size - 1, where.size),
        }
        every = np.arange(where.size)
        return np.concatenate([every[places[row]] for row in rows])

    def outputs_of_many(self, state: Array, constants: Array, threads: int | None) -> Array:
        """Return the outputs (N, T, ·) of many runs, in lanes where the method has them.

        state, constants: (N, …), as in Given.  They are those of `run` within round-off times the
        stretch of the flow.  Raises IntegrationError for the first member that fails.
        """
        kernel, count = self.kernel, len(state)
        begun = evaluate_each(self._begin.value.address, state, constants, sum(self._sizes))
        if not np.isfinite(begun).all():
            raise InputError(_OVERFLOWS)
        y, head, start = np.split(begun, np.cumsum(self._sizes[:2]), axis=1)
        line = np.hstack([start, np.tile(self._fall, (count, 1))])
        parts = []
        for begin, stop, times in self._stretches:
            here = np.hstack([head, constants])
            here[:, head.shape[1] :] = [self._within(row, begin, stop) for row in constants]
            asked = np.append(times, stop - begin)
            found = runs_of_members(kernel, self.method, here, y, stop - begin, asked, threads)
            self._check_members(found.ok, begin + found.end, found.status, found.y, begin + asked)
            size = kernel.layout.size
            y = np.ascontiguousarray(found.y[:, -1, :size])
            rows = found.y[:, :-1, :size].reshape(count * len(times), size)
            if not kernel.layout.clock:
                rows = np.hstack([rows, np.tile(begin + times, count)[:, None]])
            every = np.repeat(np.hstack([here, line]), len(times), axis=0)
            out = evaluate_each(kernel.outputs.address, rows, every, kernel.where.size)
            parts.append(out.reshape(count, len(times), kernel.where.size))
        return np.concatenate(parts, axis=1)

    def _check_members(self, ok: Any, ends: Array, status: Any, y: Array, times: Array) -> None:
        """Raise IntegrationError for the first of many runs that has not come to its end."""
        for k in range(len(ok)):
            why = wild_steps(self.kernel, self._plan, y[k], times) if ok[k] else ""
            if not ok[k]:
                why = f"it stopped at t = {ends[k]:g} s: {STATUS[int(status[k])]}"
            if why:
                raise IntegrationError(f"member {k} of {len(ok)}: {why}")

    def along(self, run: Run, rows: tuple[Outcome, ...], state: Array, constants: Array) -> Array:
        """Return the derivatives (T, rows, N) along directions of what the run began with."""
        kernel = self.kernel
        found = self._begin.forward(
            run.given.state, run.given.constants, state, constants, sum(self._sizes)
        )
        moved, head, start = np.split(found, np.cumsum(self._sizes[:2]))
        moved = moved if len(moved) else np.zeros((1, state.shape[1]))
        parameters = np.vstack([head, constants])
        line = np.vstack([start, np.zeros((len(self._fall), state.shape[1]))])
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

    def back(self, run: Run, rows: tuple[Outcome, ...], covectors: Array) -> tuple[Array, Array]:
        """Return the slopes of Σ covectors · rows by the state and constants a run began with."""
        kernel, layout = self.kernel, self.kernel.layout
        outcome, p = outcome_of(kernel, rows), self.kernel.layout.parameters
        by_parameters, by_line = np.zeros(p), np.zeros(len(run.line))
        covector, k = np.zeros(max(layout.size, 1)), len(covectors)
        for part in reversed(run.stretches):
            at_times = np.zeros((len(part.times), len(covector)))
            ends = self._ends(run, part)
            k -= len(ends)
            for j, at in enumerate(ends):
                by_state, by_rest = outcome.reverse(*at, covectors[k + j])
                at_times[j, : layout.size] = by_state[: layout.size]
                by_parameters += by_rest[:p]
                by_line += by_rest[p:]
            done = run_back(
                self.method, self._address, self._slopes, part.parameters, part.solution,
                part.times, layout.quaternion, covector, at_times,
            )  # fmt: skip
            covector = done.by_state
            by_parameters += done.by_parameters
        head = self._sizes[1]
        ends_of_begin = np.concatenate(
            [covector[: layout.size], by_parameters[:head], by_line[: self._sizes[2]]]
        )
        state, constants = self._begin.reverse(run.given.state, run.given.constants, ends_of_begin)
        return state, constants + by_parameters[head:]

    def _ends(self, run: Run, part: Stretch) -> list[tuple[Array, Array]]:
        """Return the arguments (a, b) of the outcome at each time of a stretch."""
        if not part.times.size:
            return []
        kernel = self.kernel
        t = part.begin + part.times
        states = self._states(run, part)
        poses = np.zeros((len(t), self._plan.system.group.size))
        if isinstance(states, State):
            poses = states.pose
        constants = np.concatenate([part.parameters, run.line])
        rows = part.solution.y[:, : kernel.layout.size]
        return [
            (np.concatenate([y, [time], pose]), constants)
            for y, time, pose in zip(rows, t.tolist(), poses, strict=True)
        ]

    def _count(self, rows: tuple[Outcome, ...]) -> int:
        sizes = sizes_of(self._plan.system)
        return sum(sizes[row] for row in rows)

    def _within(self, parameters: Array, begin: float, stop: float) -> Array:
        """Return the parameters with the time in them that says which piece of tables counts."""
        forces, out = self._plan.forces, parameters.copy()
        if forces is not None:
            first = len(out) - len(forces.numbers)
            out[first:][forces.within] = 0.5 * (begin + stop)
        return read_only(out)
