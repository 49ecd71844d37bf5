"""Flows of scenes with joint stops: states by `simulate`, and derivatives through impacts.

The times of impacts are those of `simulate`. Between two of them, the equations of a mode are
integrated from the state after the first to the time of the second, and tangents and covectors are
propagated over these steps. At each impact, rest or release they jump (see jumps.py).

A small change must not change the order of impacts. So a flow has no derivative where two joints
reach their stops at once, or where a joint grazes its stop or nearly does. The tolerance of the
scene decides what is at once, and what is near.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, get_args

import numpy as np
from numpy.polynomial import Chebyshev

from ...common.arrays import Array
from ...common.errors import InputError
from ...common.names import listed
from ...common.parameter import Parameter
from ...forces.controller import Controller
from ...forces.tracking import ComputedTorque
from ...integrators.integrate import Solution
from ...integrators.stepping.run_state import unit_alone
from ...kernels.flow_functions import Row
from ...kernels.kernel import Layout
from ...scene.parse_options import list_forces
from ...scene.scene import Scene
from ...scene.stop import BallBound, Bound, changed_stops
from ...system.model_parameters import joined, plain_value
from ...system.state_fields import Outcome, ShapeState, State
from ..compiled.compiled_flow import CompiledFlow
from ..impacts import bernstein
from ..plan import Span, plan_of, spans_between
from ..robot_parameters import without_own
from ..run_with_stops import Phase, StoppedMotion, locked_scene, margin_of
from ..simulate import trajectory_of
from ..trajectory import Trajectory
from .inputs import Given, motion_of, stop_numbers_of
from .jumps import Contact, ImpactJump, Jump, Side, Slots, StopInputs, jump_between, jump_of
from .propagator import Propagator
from .run_and_adjoint import Run

_DEGREE = 8  # Degree of the polynomials that describe gaps within a step.
_REAL = 1e-9  # Imaginary part of a real root, relative to the step.


class DoubtfulImpacts:
    """The checks of one motion."""

    def __init__(self, scene: Scene, motion: StoppedMotion) -> None:
        """Check the times of impacts.

        Args:
            scene: The scene with its stops.
            motion: Its motion.
        Raises:
            InputError: The flow gives states at the time of an impact.
        """
        self._scene, self._bounds = scene, scene.bounds
        self._within = scene.rtol * scene.end  # differences of times that count as none [s]
        self._last: tuple[float, frozenset[int]] = (-np.inf, frozenset())
        reports = scene.report_times
        for phase in motion.phases:
            if phase.impact is None or phase.start == 0.0:
                continue
            if np.abs(reports - phase.start).min() <= self._within:
                raise InputError(
                    f"stops: the flow gives the state at t = {phase.start:g} s, the time of an "
                    f"impact of {listed(list(phase.impact.joint), 8)}, where rates have no "
                    "derivative. Choose other times"
                )

    def tolerance(self, bound: Bound) -> float:
        """Return the distance from a stop that counts as none [rad | m]."""
        return self._scene.atol + self._scene.rtol * max(1.0, abs(bound.position))

    def refuse_start(self, x: Array, xdot: Array, wrt: Sequence[str]) -> None:
        """Reject derivatives by initial values of joints that start at their stops.

        Args:
            x: Initial shape, (nx,).
            xdot: Its rate, (m,).
            wrt: Names of the inputs with derivatives.
        Raises:
            InputError: The derivative is one-sided.
        """
        for bound in self._bounds:
            u = bound.sign * xdot[bound.v]
            if bound.sign * (x[bound.x] - bound.position) > margin_of(bound) or u > 0.0:
                continue
            for name in (f"{bound.joint}.stop.{bound.side}", "x0", "xdot0"):
                if name in wrt and (name != "xdot0" or u == 0.0):
                    raise InputError(
                        f"stops: joint '{bound.joint}' starts at its {bound.side} stop, so "
                        f"derivatives with respect to {name} are one-sided. Start away from the "
                        "stop, or omit this input"
                    )

    def refuse_together(
        self, t: float, x: Array, xdot: Array, hits: Sequence[Bound], rest: Collection[Bound]
    ) -> None:
        """Reject an impact whose order with another one the tolerances cannot decide.

        Args:
            t: Time of the impact [s].
            x: Shape, (nx,).
            xdot: Rates before it, (m,).
            hits: Stops of moving joints with an impulse.
            rest: Stops at which joints are at rest.
        Raises:
            InputError: Another joint is at its stop, or was a moment before.
        """
        joints = {bound.v for bound in hits}
        near = list(hits) if len(hits) > 1 else []
        for bound in self._bounds:
            u = bound.sign * xdot[bound.v]
            gap = bound.sign * (x[bound.x] - bound.position)
            near_gap = self.tolerance(bound) - u * self._within
            if bound.v not in joints and bound not in rest and u < 0.0 and gap <= near_gap:
                near.append(bound)
        speed = abs(xdot[hits[0].v])
        before, last = self._last
        if not last <= joints and t - before <= self._within + self.tolerance(hits[0]) / speed:
            near += [bound for bound in self._bounds if bound.v in last - joints]
        self._last = t, frozenset(joints)
        if near:
            names = list(dict.fromkeys(bound.joint for bound in (*hits, *near)))
            raise InputError(
                f"stops: {listed(names, 8)} reach their stops at one time, t = {t:g} s, so a flow "
                "has a derivative on each side only. Change the motion or a stop"
            )

    @staticmethod
    def refuse_touch(t: float, resting: Collection[Bound]) -> None:
        """Reject an event at which moving joints come to rest without an impulse."""
        for bound in resting:
            raise InputError(
                f"stops: joint '{bound.joint}' grazes its {bound.side} stop at t = {t:g} s, where "
                "a flow has no derivative. Change the motion or the stop"
            )

    @staticmethod
    def refuse_restitution(hits: Collection[Bound], wrt: Sequence[str]) -> None:
        """Reject derivatives with respect to a restitution that is zero, the least one."""
        for bound in hits:
            name = f"{bound.joint}.stop.restitution"
            if name in wrt and bound.stop.restitution == 0.0:
                raise InputError(
                    f"stops: the derivative with respect to {name} is one-sided at zero. Choose a "
                    "positive restitution, or omit this input"
                )

    def refuse_end(self, x: Array, xdot: Array, moving: Sequence[Bound]) -> None:
        """Reject a motion that ends as a joint reaches its stop."""
        for bound in moving:
            u, gap = bound.sign * xdot[bound.v], bound.sign * (x[bound.x] - bound.position)
            if u < 0.0 and gap <= self.tolerance(bound) - u * self._within:
                raise InputError(
                    f"stops: the flow ends as joint '{bound.joint}' reaches its {bound.side} stop, "
                    "where rates have no derivative. Choose another duration"
                )

    def refuse_near_misses(
        self, layout: Layout, moving: Sequence[Bound], start: float, solutions: Sequence[Solution]
    ) -> None:
        """Reject motions in which a joint nearly reaches its stop and turns back.

        Args:
            layout: Layout of the reduced states.
            moving: Stops of joints that do not rest.
            start: Start time of the first solution [s].
            solutions: Solutions between two events, in order of time.
        Raises:
            InputError: A joint comes within the tolerance of its stop without an impact.
        """
        at = {v: k for k, v in enumerate(layout.active)}
        at |= {v: 2 * layout.pairs + k for k, v in enumerate(layout.cyclic)}
        bounds = [bound for bound in moving if bound.v in at]
        if not bounds:
            return
        nodes, matrix = bernstein(_DEGREE)
        signs = np.array([bound.sign for bound in bounds])
        positions = np.array([bound.position for bound in bounds])
        tolerances = np.array([self.tolerance(bound) for bound in bounds])
        columns, is_open = [at[bound.v] for bound in bounds], np.zeros(len(bounds), dtype=bool)
        for solution in solutions:
            starts, lengths = solution.knots[:-1], np.diff(solution.knots)
            times = starts[:, None] + lengths[:, None] * nodes
            times[:, -1] = solution.knots[1:]
            y = solution.at(times.ravel())[:, columns].reshape(*times.shape, -1)
            gaps = signs * (y - positions)
            low = np.einsum("ij,sjb->sib", matrix, gaps).min(axis=1) <= tolerances
            for step, gaps_of_step in enumerate(gaps):
                for k in np.flatnonzero(low[step] & is_open).tolist():
                    place = _turning(nodes, gaps_of_step[:, k], tolerances[k])
                    if place is not None:
                        t = start + starts[step] + place * lengths[step]
                        raise InputError(
                            f"stops: joint '{bounds[k].joint}' grazes its {bounds[k].side} stop at "
                            f"t = {t:g} s, so a flow has a derivative on one side only. Change the "
                            "motion or the stop"
                        )
                is_open |= (gaps_of_step > tolerances).any(axis=0)
            start += float(solution.knots[-1])


def rows_of(phase: Phase, bounds: Sequence[Bound]) -> dict[Bound, float]:
    """Return the stops with an impulse at the start of a phase, and the rates after it."""
    if phase.impact is None:
        return {}
    stops = {(bound.joint, bound.side): bound for bound in bounds}
    keys = zip(phase.impact.joint, phase.impact.side, strict=True)
    return {stops[key]: float(rate) for key, rate in zip(keys, phase.impact.rates[1], strict=True)}


def _turning(nodes: Array, gaps: Array, tolerance: float) -> float | None:
    """Return the place in [0, 1] of a minimum of a gap that is near zero, or None."""
    gap = Chebyshev.fit(nodes, gaps, len(nodes) - 1, domain=[0.0, 1.0])
    slope = gap.deriv()
    roots = slope.roots()
    for root in np.sort(roots.real[np.abs(roots.imag) <= _REAL]).tolist():
        if 0.0 <= root <= 1.0 and abs(gap(root)) <= tolerance and slope.deriv()(root) > 0.0:
            return float(root)
    return None


_SAME = 1e-9  # Relative difference of rates before and after a switch that counts as none.


@dataclass(frozen=True)
class FlowMode:
    """A mode of a flow: its kernels, and its parameters.

    Attributes:
        propagator: Kernels of the mode.
        slots: Places of its variables among those of all modes.
        numbers: Its force parameters in the scene, (p,).
        by_numbers: Derivatives of its force parameters with respect to those of the mode without
            joints at rest, and to the numbers of stops, (p, p₀ + s).
    """

    propagator: Propagator
    slots: Slots
    numbers: Array
    by_numbers: Array

    @classmethod
    def of(
        cls, rest: tuple[Bound, ...], propagator: Propagator, free: Propagator, stops: StopInputs
    ) -> FlowMode:
        """Return a mode.

        Args:
            rest: The stops at which joints rest, in the order of the joints' places among `stops`.
            propagator: Kernels of the mode; the positions of joints at rest are Parameters.
            free: Kernels of the mode without joints at rest.
            stops: The numbers of stops.
        """
        kernel, own, other = propagator.kernel, propagator.plan.forces, free.plan.forces
        numbers = np.empty(0) if own is None else own.numbers
        count = 0 if other is None else len(other.numbers)
        by_numbers = np.zeros((len(numbers), count + len(stops.places)))
        if own is not None:
            names = [parameter.name for parameter in own.parameters]
            for k, bound in enumerate(rest):
                place, slope = stops.position(bound)
                by_numbers[:, count + place] += slope * own.slopes[:, names.index(place_name(k))]
            if other is not None and other.parameters:
                columns = [names.index(parameter.name) for parameter in other.parameters]
                by_numbers[:, :count] = own.slopes[:, columns] @ np.linalg.pinv(other.slopes)
        slots = Slots.of(kernel.system, kernel.layout)
        return cls(propagator, slots, numbers, by_numbers)

    def others(self, free: Array) -> Array:
        """Return the parameters after the constant momenta along directions of those of `free`.

        Args:
            free: Directions of the parameters of the mode without joints at rest, (q₀, …).
        Returns:
            (q, …).
        """
        first = len(free) - self.by_numbers.shape[1]
        return np.concatenate([free[:first], self.by_numbers @ free[first:]])

    def cotangent(self, others: Array) -> Array:
        """Return covectors (q₀,) of the parameters of `free` from those of this mode, (q,)."""
        first = len(others) - len(self.numbers)
        return np.concatenate([others[:first], others[first:] @ self.by_numbers])

    def flow(self, run: StoppedRun, own: Array, t: float, stop: float) -> CompiledFlow:
        """Return the flow of the mode between two times, without a state.

        Args:
            run: The run.
            own: Force parameters of the mode without joints at rest, and numbers of stops, in the
                scene, (p₀ + s,).
            t: Start time [s].
            stop: End time [s].
        """
        free, layout = run.flow, self.propagator.kernel.layout
        first = free.kernel.layout.gravity_at
        params = self.others(np.concatenate([free.parameters[first:], run.stops]))
        params[len(params) - len(self.numbers) :] += self.numbers - self.by_numbers @ own
        spin = free.parameters[: layout.base.spin]
        columns = [spin, np.zeros(len(layout.constant_pi)), params]
        forces = self.propagator.plan.forces
        flow = CompiledFlow(
            self.propagator.kernel, None if forces is None else forces.tables,
            np.zeros(layout.size), np.concatenate(columns), free.path,
        )  # fmt: skip
        return replace(flow, parameters=flow.parameters_between(t, stop))


@dataclass(frozen=True)
class Part:
    """The solution over one span of a run with stops.

    Attributes:
        mode: The mode.
        flow: Flow of the mode.
        span: The span.
        solution: The solution.
        jump: The jump of derivatives at its start; None if there is none.
    """

    mode: FlowMode
    flow: CompiledFlow
    span: Span
    solution: Solution
    jump: ImpactJump | Jump | None


@dataclass
class StoppedRun(Run):
    """One evaluation of a flow map with stops.

    Attributes:
        trajectory: The motion by `simulate`.
        stops: Numbers of the stops, (s,).
        parts: Solutions for derivatives; None until they are needed.
    """

    trajectory: Trajectory
    stops: Array
    parts: list[Part] | None = None


class StoppedPropagator(Propagator):
    """The propagator of a scene with joint stops; see Propagator.

    Its own kernel is that of the mode without joints at rest.
    """

    def __init__(self, scene: Scene, wrt: Sequence[str], *, zero_momentum: bool) -> None:
        """Prepare the kernels.

        Args:
            scene: The scene.
            wrt: Names of the inputs with derivatives.
            zero_momentum: Whether the angular momentum is zero for all inputs.
        Raises:
            InputError: The scene has closed loops, or it or its method has no derivatives.
        """
        if scene.system.loops:
            raise InputError(
                f"stops: flows with stops take no closed loops, but '{scene.system.name}' has "
                "some. Omit stops, or open the loops when it is loaded (loops=)"
            )
        for bound in scene.bounds:
            if bound.surface is not None:
                is_ball = isinstance(bound, BallBound)
                what = (
                    f"ball '{bound.joint}'" if is_ball else f"follower '{bound.joint}' of several"
                )
                remedy = (
                    "load the ball as three hinges" if is_ball else "state stops of its leaders"
                )
                raise InputError(
                    f"stops: flows take stops of hinges and slides, got one of {what}. Omit it, or "
                    f"{remedy}"
                )
        laws = [force for force in list_forces(scene.forces)
                if isinstance(force, (Controller, ComputedTorque))]  # fmt: skip
        if laws:
            raise InputError(
                f"stops: flows with stops take no {type(laws[0]).__name__}, whose commands do not "
                "follow the derivatives of a joint at rest. Omit it, or omit stops"
            )
        self.scene, self._wrt, self._free = scene, tuple(wrt), replace(scene, stops=None)
        super().__init__(plan_of(self._free), zero_momentum=zero_momentum)
        self._bounds = {(bound.joint, bound.side): bound for bound in scene.bounds}
        self._stop_numbers = stop_numbers_of(scene)
        places = {name: k for k, name in enumerate(self._stop_numbers)}
        fixed = tuple(place for name, place in places.items() if name not in self._wrt)
        self._stops = StopInputs(places, fixed)
        free = FlowMode.of((), self, self, self._stops)
        self._modes: dict[tuple[Bound, ...], FlowMode] = {(): free}

    def run(self, given: Given, *, stages: bool = False) -> StoppedRun:  # noqa: ARG002
        """Simulate the scene with the inputs; see Propagator.run."""
        trajectory = trajectory_of(without_own(self._scene_of(given)))
        of_kernel, stops = self._divided(given.constants)
        given = replace(given, constants=of_kernel)
        return StoppedRun(given, self.initial(given), [], [], trajectory, stops)

    def _divided(self, constants: Array) -> tuple[Array, Array]:
        """Divide constants of the inputs into those of the kernel and the numbers of stops."""
        at = len(constants) - len(self._stop_numbers)
        return constants[:at], constants[at:]

    def end(self, run: Run) -> State | ShapeState:
        """Return the final full state of a run."""
        return _trajectory_in(run).at(self.scene.end)

    def states(self, run: Run) -> State | ShapeState:
        """Return the full states of a run at the report times."""
        return _trajectory_in(run).outputs

    def outputs(self, run: Run) -> Array:
        """Return the outputs of a flow, among those of the kernel, (T, ·), at the report times."""
        states, where = self.states(run), self.kernel.where
        outputs = np.full((len(self.scene.report_times), where.size), np.nan)
        for name in get_args(Outcome):
            if name in where.fields:
                outputs[:, where.fields[name]] = getattr(states, name).reshape(len(outputs), -1)
        return outputs

    def outputs_of_many(self, *_: Any, **__: Any) -> Array:
        """Reject runs in SIMD lanes; the adapters run the inputs one after another."""
        raise InputError("stops: runs with stops do not share steps, so they have no SIMD lanes")

    def one_step(self, *_: Any, **__: Any) -> tuple[State | ShapeState, Array]:
        """Reject single steps, which do not look for impacts."""
        raise InputError("stops: a single step looks for no impacts. Omit stops, or call the flow")

    def along(self, run: Run, rows: tuple[Row, ...], state: Array, constants: Array) -> Array:
        """Return derivatives of outputs along N directions of the inputs; see Propagator."""
        own, stops = self._divided(constants)
        y, parameters, path = self.initial.along(run.given, state, own)
        first = self.kernel.layout.gravity_at
        tangents = y, parameters[:first], np.vstack([parameters[first:], stops]), path
        return self._finite(np.array(self.tangents(run, rows, *tangents)[2]))[0]

    def tangents(
        self, run: Run, rows: tuple[Row, ...], y: Array, head: Array, others: Array, path: Array
    ) -> tuple[Array, Array, list[Array]]:
        """Propagate N tangents over a run.

        Args:
            run: The run.
            rows: Names of the outputs.
            y: Tangents of the initial state, (n, N).
            head: Tangents of the constant momenta, (c, N).
            others: Tangents of the other parameters and of the numbers of stops, (q + s, N).
            path: Tangents of the path of the centre of mass, (3k, N).
        Returns:
            Tangents of the state and of the constant momenta at the end, and of the outputs at each
            report time, (rows, N).
        """
        derivatives = list[Array]()
        for part in self.parts_of(run):
            own = part.mode.others(others)
            if isinstance(part.jump, Jump):
                delay = part.jump.delay(own[len(own) - len(part.mode.numbers) :])
                y = y + np.outer(part.jump.change, delay)
            elif part.jump is not None:
                size = len(part.mode.slots.state)
                y = part.jump.matrix @ np.vstack([y[: part.jump.before], head, others])
                y, head = y[:size], y[size:]
            y = y if len(y) else np.zeros((1, y.shape[1]))
            constant = np.vstack([head, own]), path
            y, outputs = part.mode.propagator.along_span(
                part.flow, part.span, part.solution, rows, y, constant
            )
            derivatives += outputs
        return y, head, derivatives

    def back(self, run: Run, rows: tuple[Row, ...], covectors: Array) -> tuple[Array, ...]:
        """Return the cotangents of the inputs' state and constants; see Propagator."""
        parts = self.parts_of(run)
        count = self.kernel.layout.parameters - self.kernel.layout.gravity_at
        others = np.zeros(count + len(self._stop_numbers))
        path, head = np.zeros(len(run.flow.path)), np.zeros(len(parts[-1].mode.slots.constant))
        covector, weights = np.zeros(max(len(parts[-1].mode.slots.state), 1)), (rows, covectors)
        for part in reversed(parts):
            layout = part.mode.propagator.kernel.layout
            by_rest = np.zeros(layout.parameters + len(path))
            covector = part.mode.propagator.back_span(
                part.flow, part.span, part.solution, weights, covector, by_rest
            )
            head = head + by_rest[: layout.gravity_at]
            own = by_rest[layout.gravity_at : layout.parameters]
            path += by_rest[layout.parameters :]
            if isinstance(part.jump, Jump):
                numbers = own[len(own) - len(part.mode.numbers) :]
                numbers += (covector @ part.jump.change) * part.jump.only_slopes()
            others += part.mode.cotangent(own)
            if isinstance(part.jump, ImpactJump):
                whole = np.concatenate([covector[: layout.size], head]) @ part.jump.matrix
                covector, head, more = np.split(whole, [part.jump.before, len(whole) - len(others)])
                others += more
                covector = covector if covector.size else np.zeros(1)
        by_parameters = np.concatenate([head, others[:count]])
        by_state, by_own = self.initial.back(run.given, covector, by_parameters, path)
        return self._finite(by_state, np.concatenate([by_own, others[count:]]))

    def _scene_of(self, given: Given) -> Scene:
        """Return the scene with other inputs."""
        scene, system, options = self.scene, self.scene.system, dict[str, Any]()
        own, motion = scene.given, motion_of(scene)
        start = own.pose[0], own.x[0], own.xdot[0], own.motion[0]
        if not np.array_equal(given.state, np.concatenate(start)):
            cuts = np.cumsum([system.group.size, system.nx, system.m]).tolist()
            pose, x, xdot, stated = np.split(given.state, cuts)
            options = {"pose0": pose, "x0": x, "xdot0": xdot, "xi0": None, "momentum": None}
            options["xi0" if motion == "xi" else "momentum"] = stated
            options |= dict.fromkeys(("seed", "keyframe", "q0", "v0"))
        robot = {name: plain_value(value) for name, value in given.robot.items()}
        if given.stops:
            stops: Any = scene.stops
            options["stops"] = changed_stops(stops, given.stops)
        if given.forces or robot:
            options["parameters"] = joined(scene.parameters, {**given.forces, **robot})
        return replace(scene, **options) if options else scene

    def _mode(self, rest: tuple[Bound, ...]) -> FlowMode:
        """Return a mode, whose kernels are built at its first use."""
        # The positions of stops are inputs, so modes are identified by the stops of the scene.
        bounds = tuple(self._bounds[bound.joint, bound.side] for bound in rest)
        mode = self._modes.get(bounds)
        if mode is None:
            places = [Parameter(place_name(k), bound.position) for k, bound in enumerate(bounds)]
            x, xdot = self._free.start.x.copy(), self._free.start.xdot.copy()
            for bound in bounds:
                x[bound.x], xdot[bound.v] = bound.position, 0.0
            plan = plan_of(locked_scene(self._free, bounds, x, xdot, places))
            propagator = Propagator(plan, zero_momentum=self.zero_momentum)
            mode = self._modes[bounds] = FlowMode.of(bounds, propagator, self, self._stops)
        return mode

    def parts_of(self, run: Run) -> list[Part]:
        """Return the solutions of a run.  Raises InputError if it has no derivatives."""
        assert isinstance(run, StoppedRun)
        if run.parts is None:
            run.parts = list(self._solve_parts(run))
        return run.parts

    def _solve_parts(self, run: StoppedRun) -> Iterator[Part]:
        """Integrate each mode from one event to the next, and yield the solutions."""
        motion, scene = run.trajectory.motion, run.trajectory.scene
        assert isinstance(motion, StoppedMotion)
        doubts = DoubtfulImpacts(scene, motion)
        ends = np.array([segment.end for phase in motion.phases for segment in phase.segments])
        spans = iter(spans_between(ends, scene.report_times))
        mode, flow, y, t = self._modes[()], run.flow, run.flow.y0, 0.0
        rest: tuple[Bound, ...] = ()
        doubts.refuse_start(*flow.canonical_momenta(t, y)[:2], self._wrt)
        for phase in motion.phases:
            jump: ImpactJump | Jump | None = None
            solutions = list[Solution]()
            for segment in phase.segments:
                span = next(spans)
                if solutions:
                    jump = self._switch(run, mode, flow, span, y)
                elif phase.start > 0.0 or phase.mode.rest or phase.impact is not None:
                    before = replace(flow, parameters=flow.parameters_between(t, phase.start))
                    side = Side(before, mode.slots, y, rest)
                    jump, mode = self._event(run, doubts, phase, mode, side)
                    rest = phase.mode.rest
                    flow = jump.flow
                    y = flow.y0
                longest = float(np.diff(segment.knots).max())
                solution = mode.propagator.solution(replace(flow, y0=y), span, longest)
                yield Part(mode, flow, span, solution, jump)
                y, t = _unit(solution.states[-1], mode.propagator), span.start
                solutions.append(solution)
            layout, moving = mode.propagator.kernel.layout, phase.mode.moving
            doubts.refuse_near_misses(layout, moving, phase.start, solutions)
        last = replace(flow, parameters=solution.params)
        doubts.refuse_end(*last.canonical_momenta(scene.end, y)[:2], phase.mode.moving)

    def _event(
        self,
        run: StoppedRun,
        doubts: DoubtfulImpacts,
        phase: Phase,
        mode: FlowMode,
        before: Side,
    ) -> tuple[ImpactJump, FlowMode]:
        """Return the jump at the start of a phase, and the mode after it."""
        t, end = phase.start, phase.segments[0].end
        after = self._mode(phase.mode.rest)
        flow = after.flow(run, self._numbers, t, end)
        free = replace(run.flow, parameters=run.flow.parameters_between(t, end))
        rates = rows_of(phase, run.trajectory.scene.bounds)
        hits = tuple(bound for bound in rates if bound not in before.rest)
        x, xdot, _ = before.flow.canonical_momenta(t, before.y)
        depth, delay = 0.0, None
        doubts.refuse_restitution(hits, self._wrt)
        if t > 0.0 and hits:
            doubts.refuse_together(t, x, xdot, hits, before.rest)
            depth = doubts.tolerance(hits[0])
            self._refuse_switch(run, before, t)
        elif t > 0.0:
            doubts.refuse_touch(t, set(phase.mode.rest) - set(before.rest))
            delay = self._delay(run, mode, before, t)
        contact = Contact(
            t, hits, tuple(bound.stop.restitution * (rates[bound] != 0.0) for bound in hits),
            frozenset(rates) - frozenset(hits), self._stops, t > 0.0, depth,
        )  # fmt: skip
        sides = (
            Side(free, self._modes[()].slots, run.flow.y0, ()), before,
            Side(flow, after.slots, flow.y0, phase.mode.rest),
        )  # fmt: skip
        return jump_of(*sides, contact, delay), after

    @cached_property
    def _numbers(self) -> Array:
        """Force parameters of the scene, and numbers of its stops, (p + s,)."""
        numbers = np.empty(0) if self.plan.forces is None else self.plan.forces.numbers
        return np.concatenate([numbers, [*self._stop_numbers.values()]])

    def _stop_at(self, run: StoppedRun, t: float) -> int | None:
        """Return the index of the stop of the plan at a time, or None if there is none."""
        stops = run.trajectory.plan.stops[:-1]
        near = np.flatnonzero(np.abs(stops - t) <= self.scene.rtol * self.scene.end)
        return int(near[0]) if near.size else None

    def _slopes(self, run: StoppedRun, mode: FlowMode, flow: CompiledFlow, k: int) -> Array:
        """Return the derivatives of a stop with respect to the force parameters of a mode."""
        forces = mode.propagator.plan.forces
        if forces is None or not mode.propagator.plan.stops_vary:
            return np.zeros((0, len(mode.numbers)))
        return forces.switching.slopes(run.trajectory.plan.stops, flow.numbers)[k]

    def _switch(
        self, run: StoppedRun, mode: FlowMode, flow: CompiledFlow, span: Span, y: Array
    ) -> Jump | None:
        """Return the jump of derivatives at the start of a span at which no joint has an impact."""
        k = self._stop_at(run, span.start)
        if k is None:
            return None
        slopes = self._slopes(run, mode, flow, k)
        params = [
            flow.parameters_between(*ends)
            for ends in ((span.start - 1e-9 * span.start, span.start), (span.start, span.stop))
        ]
        return jump_between(mode.propagator.kernel, params, y, span.start, slopes)

    def _delay(self, run: StoppedRun, mode: FlowMode, before: Side, t: float) -> Array | None:
        """Return the derivatives of the time of a release at which forces switch, or None."""
        k = self._stop_at(run, t)
        slopes = np.zeros((0, 0)) if k is None else self._slopes(run, mode, before.flow, k)
        if not slopes.any():
            return None
        layout = mode.propagator.kernel.layout
        others = np.zeros(layout.parameters - layout.gravity_at)
        others[len(others) - len(mode.numbers) :] = Jump(t, np.empty(0), slopes).only_slopes()
        return mode.cotangent(others)

    def _refuse_switch(self, run: StoppedRun, before: Side, t: float) -> None:
        """Reject an impact at a time at which forces switch."""
        k = self._stop_at(run, t)
        if k is None:
            return
        times = np.append(0.0, run.trajectory.plan.stops)[k : k + 3].tolist()
        spans = pairwise(times)
        flows = [replace(before.flow, parameters=before.flow.parameters_between(*s)) for s in spans]
        rates = np.array([replace(before, flow=flow).rates for flow in flows])
        if np.abs(rates[1] - rates[0]).max(initial=0.0) > _SAME * np.abs(rates).max(initial=0.0):
            raise InputError(
                f"stops: a force switches at t = {t:g} s, the time of an impact, so a flow has a "
                "derivative on each side only. Change the motion or the force"
            )


def place_name(k: int) -> str:
    """Return the name of the Parameter that is the position of the k-th joint at rest."""
    return f"position of the joint {k} at its stop"


def _trajectory_in(run: Run) -> Trajectory:
    assert isinstance(run, StoppedRun)
    return run.trajectory


def _unit(y: Array, propagator: Propagator) -> Array:
    """Return a state with quaternions of length one."""
    unit = y.copy()
    unit_alone(unit, propagator.kernel.layout.quaternions)
    return unit
