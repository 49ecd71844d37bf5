"""Motion: the segments of an integrated scene, with located events and controller calls.

Integration stops where a force is not smooth, or where a controller is due.  A `Control` calls the
controllers, and records the calls.  A `Replay` repeats the actions of a motion, so that another
simulation runs under the same actions.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from ..common.arrays import Array, read_only
from ..common.errors import InputError
from ..common.names import brief
from ..common.waiting import Progress
from ..forces.columns import Vector
from ..forces.force_numbers import BaseInSpace
from ..forces.switch_times import time_within
from ..scene.scene import Scene
from ..scene.stop import Bound
from ..system.coordinates import Indices
from ..system.force_interface import SeenState
from ..system.state_fields import ShapeState, State, map_arrays
from ..system.system import System
from .checkpoint import Part, RunRecord
from .events import Crossing, Watch, cut_at
from .impacts import ImpactTable
from .plan import Plan
from .reduced_flow import Integrate, ReducedFlow, Sample, Segment, map_samples

# Times closer than this fraction of the duration count as equal.
_ROUND_OFF = 1e-12
# A controller is due if the time is this close to a multiple of its period, relative to the period.
_DUE = 1e-9

See = Callable[[], Sample]


@dataclass(frozen=True)
class ControlAction:
    """One call of a controller, with its result.

    Attributes:
        t: Time of the call [s].
        controller: Name of the controller.
        torque: Torque by joint before its limit [N·m | N], or control by actuator (Scene.controls).
        wrench: Wrench on the base in the body frame as [linear; angular], (r,) [N | N·m], or None.
        width: Duration of a pulse [s]; None for a zero-order hold until the next call.
        seen: The observed state.
    """

    t: float
    controller: str
    torque: Mapping[str, float]
    wrench: Array | None
    width: float | None
    seen: Sample


class Control:
    """The controllers of one simulation, with their states.  Use a new object for each run.

    Attributes:
        calls: Records of all calls so far.
    """

    def __init__(self, scene: Scene) -> None:
        """Start with copies of the initial states of the controllers."""
        self._scene, self._forces = scene, scene.force_model
        controllers = [] if self._forces is None else self._forces.held
        self._states = [deepcopy(c.state0) if c.keeps_state else None for c, _ in controllers]
        self._called = [-1] * len(controllers)
        self._until = [np.inf] * len(controllers)
        self.calls: list[ControlAction] = []

    def begin(self, numbers: Array, t: float, stop: float, see: See) -> float:
        """Call the controllers that are due at t, and set the force parameters.

        Args:
            numbers: Force parameters, (p,), changed in place.
            t: Start of the next segment [s].
            stop: Latest end of the segment [s].
            see: Function that returns the observed state at t, called if a controller is due.
        Returns:
            End of the segment [s].
        """
        forces = self._forces
        if forces is None:
            return stop
        near, sample = _ROUND_OFF * self._scene.end, None
        for k, (controller, where) in enumerate(forces.held):
            if self._until[k] <= t + near:  # the pulse has ended
                numbers[where], self._until[k] = 0.0, np.inf
            # Calls are at multiples of the period, the first call at t = 0.
            count = round(t / controller.period)
            if count > self._called[k] and abs(t / controller.period - count) < _DUE:
                self._called[k] = count
                sample = see() if sample is None else sample
                numbers[where], self._until[k] = self._call(k, t, sample)
        until = min([stop, *(u for u in self._until if u < stop - near)])
        forces.set_span(numbers, time_within(t, until))
        return until

    def saved(self) -> dict[str, Any]:
        """Return the state of all controllers as nested values, to continue the run later.

        Raises InputError if the state of a controller cannot be pickled.
        """
        return {
            "states": [self._pickled(k) for k in range(len(self._states))],
            "called": list(self._called),
            "until": list(self._until),
            "calls": [_saved_action(action) for action in self.calls],
        }

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Continue from a saved state, which must be signed by the user: it is unpickled."""
        self._states = [pickle.loads(data) for data in saved["states"]]
        self._called, self._until = list(saved["called"]), list(saved["until"])
        self.calls = [_restored_action(action) for action in saved["calls"]]

    def _pickled(self, k: int) -> bytes:
        try:
            return pickle.dumps(self._states[k])
        except Exception as error:
            assert self._forces is not None
            controller, _ = self._forces.held[k]
            raise InputError(
                f"checkpoint: expected a state of {controller.name} that can be pickled, got "
                f"{brief(self._states[k])}: {error}. Use numbers, arrays, lists and dictionaries"
            ) from error

    def _call(self, k: int, t: float, seen: Sample) -> tuple[Array, float]:
        """Call controller k; return its force parameters and the end of its pulse [s]."""
        forces, system = self._forces, self._scene.system
        assert forces is not None
        controller, _ = forces.held[k]
        names, r = system.shape_names, system.r
        command, self._states[k] = controller.sample(
            _measured(t, seen, system), seen.mu, self._states[k]
        )
        action = controller.held(command, names, r, t)
        joints, values, width = controller.driven(names), action.values, action.width
        torque = dict(zip(joints, values.tolist(), strict=False))
        wrench = read_only(values[len(joints) :].copy()) if controller.wrench else None
        self.calls.append(ControlAction(t, controller.name, torque, wrench, width, seen))
        if width is None:
            return values, np.inf
        if width <= _ROUND_OFF * self._scene.end:
            return np.zeros_like(values), np.inf
        return values, t + width


def _saved_action(action: ControlAction) -> dict[str, Any]:
    observed = vars(action.seen) | {"base": action.seen.base and dict(vars(action.seen.base))}
    return vars(action) | {"torque": dict(action.torque), "seen": observed}


def _restored_action(saved: Mapping[str, Any]) -> ControlAction:
    observed = dict(saved["seen"])
    observed["base"] = observed["base"] and BaseInSpace(**observed["base"])
    wrench = saved["wrench"]
    wrench = wrench if wrench is None else read_only(wrench)
    return ControlAction(**{**saved, "wrench": wrench, "seen": Sample(**observed)})


def _measured(t: float, seen: Sample, system: System) -> SeenState:
    """Return the state that a controller observes; its arrays are copies."""
    x, base = Vector.of(seen.x, system.x_names, "x"), seen.base
    xdot = Vector.of(seen.xdot, system.shape_names, "xdot")
    if base is None:  # Scenes leave out the base only if no controller observes it.
        return SeenState(t, x, xdot, None, None, None, None)
    group = system.group
    momenta = group.components("momentum")
    return SeenState(
        t,
        x,
        xdot,
        Vector.of(base.pose, group.components("pose"), "pose"),
        Vector.of(base.xi, group.components("twist"), "xi"),
        Vector.of(base.mu, momenta, "mu"),
        Vector.of(base.J, momenta, "J"),
    )


class Replay:
    """The actions of a motion, repeated segment by segment."""

    def __init__(self, ends: Array, numbers: Sequence[Array]) -> None:
        """Store the end times (S,) [s] of the segments and their force parameters, (p,) each."""
        self._ends, self._numbers = ends, numbers

    def begin(self, numbers: Array, t: float, stop: float, see: See) -> float:  # noqa: ARG002
        """Set the force parameters of the motion at t; see Control.begin."""
        k = min(int(np.searchsorted(self._ends, t, side="right")), len(self._ends) - 1)
        numbers[:] = self._numbers[k]
        return min(stop, float(self._ends[k])) if self._ends[k] > t else stop


@dataclass(frozen=True)
class Changes:
    """Reduced states and their rates at times (T,).

    Attributes:
        which: Index of the segment that contains each time, (T,).
        y: Reduced states, (T, k).
        rates: Time derivatives of the reduced states, (T, k).
    """

    which: Indices
    y: Array
    rates: Array


class Segments(Sequence[Segment]):
    """Segments in order of time.

    Attributes:
        steps: Number of accepted steps.
        evaluations: Number of evaluations of the vector field.
    """

    def __init__(self, segments: Sequence[Segment]) -> None:
        """Collect segments."""
        self._segments = segments
        self.steps = sum(segment.steps for segment in segments)
        self.evaluations = sum(segment.evaluations for segment in segments)

    @cached_property
    def ends(self) -> Array:
        """End times, (S,) [s]."""
        return np.array([segment.end for segment in self._segments])

    @cached_property
    def knots(self) -> Array:
        """Times of all step ends, (K,) sorted [s]."""
        return np.unique(np.concatenate([segment.knots for segment in self]))

    def __len__(self) -> int:
        return len(self.ends)

    def __getitem__(self, k: Any) -> Any:
        return self._segments[k]


class Motion:
    """A solved scene: full states at any time.

    Attributes:
        flow: The reduced flow.
        segments: Segments in order of time.
        actions: Calls of the controllers.
        crossings: Crossings of the events.
        ended_by: The crossing that ended the motion, or None if no event ended it.
        building: Wall time for kernels that were built during the integration [s].
    """

    building = 0.0

    def __init__(
        self,
        flow: ReducedFlow,
        segments: list[Segment] | Segments,
        *,
        varies: bool = False,
        actions: Sequence[ControlAction] = (),
        watch: Watch | None = None,
    ) -> None:
        """Store a flow and its segments.

        Args:
            flow: The reduced flow.
            segments: Segments in order of time.
            varies: Whether the map from reduced to full states changes from segment to segment.
            actions: Calls of the controllers.
            watch: Detection of events; None for scenes without events.
        """
        self.flow, self._varies = flow, varies
        self.segments = Segments(segments) if isinstance(segments, list) else segments
        self._width = len(flow.y0)  # of a reduced state
        self.actions = tuple(actions)
        self.crossings: list[Crossing] = [] if watch is None else watch.crossings
        self.ended_by = None if watch is None else watch.end

    @property
    def steps(self) -> int:
        """Number of accepted steps."""
        return self.segments.steps

    @property
    def evaluations(self) -> int:
        """Number of evaluations of the vector field."""
        return self.segments.evaluations

    @property
    def knots(self) -> Array:
        """Times of all step ends, (K,) [s]."""
        knots: Array = self.segments.knots
        return knots

    @property
    def step_spans(self) -> tuple[Array, Array]:
        """Starts and ends of all steps, (S,) [s]; a step after an impact starts just after it."""
        return self.knots[:-1], self.knots[1:]

    @property
    def replay(self) -> Replay:
        """The actions of the controllers, for another simulation."""
        return Replay(self.segments.ends, [self._numbers(k) for k in range(len(self.segments))])

    def flow_of(self, k: int) -> ReducedFlow:  # noqa: ARG002
        """Return the flow of segment k."""
        return self.flow

    @property
    def impacts(self) -> ImpactTable | None:
        """The impacts at joint stops; None without stops."""
        return None

    @property
    def work_of_drives(self) -> tuple[Array, Array]:
        """Times of impacts, (I,) [s], and the work of prescribed joints in each, (I,) [J]."""
        return np.empty(0), np.empty(0)

    @property
    def modes(self) -> tuple[tuple[float, str], ...]:
        """Start time [s] and name of each mode; one without joint stops."""
        return ((0.0, "no joint at rest"),)

    def resting(self, t: Array) -> Iterator[tuple[tuple[Bound, ...], Indices]]:
        """Yield the stops at which joints rest, with the indices of times (T,).

        Args:
            t: Times, (T,) [s].
        Yields:
            The stops, and the indices of times; every time once.
        """
        yield (), np.arange(len(t))

    def reduced(self, t: Array) -> Array:
        """Return the reduced states at times (T,), (T, k)."""
        if len(self.segments) == 1:
            return np.asarray(self.segments[0].at(t))
        y = np.zeros((len(t), self._width))
        for k, indices in self._by_segment(self._which(t)):
            states = self.segments[k].at(t[indices])
            y[indices, : states.shape[1]] = states
        return y

    def states(self, t: Array) -> State | ShapeState:
        """Return the full states at times (T,)."""
        y = self.reduced(t)
        if not self._varies:
            return self.flow.states(t, y, self.segments[-1].parameters)
        return self._states(t, y, self._which(t))

    def samples(self, t: Array) -> tuple[Sample, Array]:
        """Return the states at times (T,) that forces depend on, and force parameters, (T, p)."""
        y, which = self.reduced(t), self._which(t)
        numbers = np.array(self.numbers(t)).reshape(len(t), -1)
        samples, order = [], []
        for k, indices in self._by_segment(which):
            parameters = self.segments[k].parameters
            samples.append(self.flow_of(k).samples(t[indices], y[indices], parameters))
            order.append(indices)
        inverse_order = np.argsort(np.concatenate(order))
        return map_samples(lambda columns: np.concatenate(columns)[inverse_order], samples), numbers

    def numbers(self, t: Array) -> list[Array]:
        """Return the force parameters (p,) at each of times (T,)."""
        return [self._numbers(k) for k in self._which(t)]

    def changes(self, t: Array) -> Changes:
        """Return reduced states and their rates at times (T,), without round-off of the time."""
        y, which = np.array(self.reduced(t)), self._which(t)
        rates = np.zeros_like(y)
        for k, indices in self._by_segment(which):
            flow, parameters = self.flow_of(k), self.segments[k].parameters
            states = y[indices, : len(flow.y0)]
            states[:, flow.clock] = t[indices, None]
            y[indices, : len(flow.y0)] = states
            rates[indices, : len(flow.y0)] = flow.rates(t[indices], states, parameters)
        return Changes(which, y, rates)

    def beside(self, t: Array, changes: Changes, s: Array) -> Array:
        """Return the velocities at times t + s, with reduced states extrapolated linearly from t.

        Args:
            t: Times, (T,) [s].
            changes: Reduced states and their rates at times t.
            s: Rows of time differences, (K, T) [s].
        Returns:
            Body twist and shape rate at times t + s, (K, T, n).
        """
        y, times = changes.y + s[..., None] * changes.rates, (t + s).ravel()
        which = np.tile(changes.which, len(s))
        states = self._states(times, y.reshape(len(times), -1), which)
        assert isinstance(states, State)
        return np.hstack([states.xi, states.xdot]).reshape(*s.shape, -1)

    def _states(self, t: Array, y: Array, which: Indices) -> State | ShapeState:
        """Compute full states from reduced states of several segments."""
        states, order = [], []
        for k, indices in self._by_segment(which):
            states.append(
                self.flow_of(k).states(t[indices], y[indices], self.segments[k].parameters)
            )
            order.append(indices)
        inverse_order = np.argsort(np.concatenate(order))
        return map_arrays(lambda *columns: np.concatenate(columns)[inverse_order], *states)

    def _by_segment(self, which: Indices) -> Iterator[tuple[int, Indices]]:
        """Yield the index of each segment in `which`, with the indices of the times in it."""
        order = np.argsort(which, kind="stable")
        firsts = np.flatnonzero(np.diff(which[order], prepend=-1))
        for first, last in pairwise([*firsts.tolist(), len(order)]):
            yield int(which[order[first]]), order[first:last]

    def _numbers(self, k: int) -> Array:
        """Return the force parameters of the scene in segment k, (p,)."""
        numbers: Array = self.segments[k].parameters[self.flow.numbers_at]
        return numbers

    def _which(self, t: Array) -> Indices:
        """Return the segment index of each time; a stop belongs to the segment that it ends."""
        return np.minimum(
            np.searchsorted(self.segments.ends, t, side="left"), len(self.segments) - 1
        )


@dataclass(frozen=True)
class _Followers:
    """The controllers and events of a run, whose states are saved together."""

    control: Control
    watch: Watch | None

    def saved(self) -> dict[str, Any]:
        watch = None if self.watch is None else self.watch.saved()
        return {"control": self.control.saved(), "watch": watch}

    def restore(self, saved: Mapping[str, Any]) -> None:
        self.control.restore(saved["control"])
        if self.watch is not None:
            self.watch.restore(saved["watch"])


def _continue(
    record: RunRecord, integrate: Integrate, followers: _Followers
) -> tuple[list[Segment], Part | None]:
    """Restore a saved run; return its finished segments, and the part that is not finished."""
    segments = []
    for part in record.finished:
        record.begin(part)
        segments.append(integrate(part.start, part.end, part.y0, part.parameters, None, record))
    current = record.current
    saved = record.follower if current is None else current.follower
    if saved is not None:
        followers.restore(saved)
    return segments, current


def follow(
    plan: Plan,
    flow: ReducedFlow,
    integrate: Integrate,
    record: RunRecord | None = None,
    *,
    thinned: bool = False,
) -> Motion:
    """Integrate a flow from stop to stop, with the actions of controllers and events.

    Args:
        plan: The plan of the scene.
        flow: Reduced flow of the plan.
        integrate: The function that integrates the flow.
        record: Record of the run in a checkpoint, from which it continues; or None.
        thinned: Whether segments do not store their step ends. Then events are searched for while
            the steps are integrated.
    Returns:
        The motion.
    Raises:
        IntegrationError: The integration failed.
    """
    t, y, parameters = 0.0, flow.y0, flow.parameters.copy()
    numbers = parameters[flow.numbers_at]
    if len(plan.stops) == 1 and record is None and not plan.is_observed:
        end = plan.scene.end
        if plan.forces is not None:
            plan.forces.set_span(numbers, time_within(0.0, end))
        return Motion(flow, [integrate(0.0, end, y, read_only(parameters))])
    control, watched = Control(plan.scene), plan.scene.watched
    watch = None if watched is None else Watch(plan.scene, flow, watched)
    stopping = watch.look if watch is not None and (watch.may_end or thinned) else None
    segments: list[Segment] = []
    part, followers = None, _Followers(control, watch)
    if record is not None:
        record.begin_run(followers.saved)
        segments, part = _continue(record, integrate, followers)
        if part is not None:
            t, y, parameters[:] = part.start, part.y0, part.parameters
        elif segments:  # the run is finished
            t = plan.scene.end
    for stop in plan.stops.tolist():
        while t < stop and (watch is None or watch.end is None):
            if part is None:
                until = control.begin(numbers, t, stop, partial(flow.sample, t, y, parameters))
                part = Part(t, until, y, read_only(parameters.copy()))
            if record is not None:
                record.begin(part)
            segment = integrate(part.start, part.end, y, part.parameters, stopping, record)
            if watch is not None and watch.look(segment) and watch.end is not None:
                segments += cut_at(watch.end.t, segment, integrate)
                break
            segments.append(segment)
            t, part = part.end, None
            if t != plan.stops[-1]:
                y = segment.at(np.array([t]))[0]
    varies = bool(plan.driven) and len(segments) > 1
    return Motion(flow, segments, varies=varies, actions=control.calls, watch=watch)


class Solver(NamedTuple):
    """What an engine does with a plan.

    Attributes:
        method: Name of its method.
        degree: Degree of the method's dense output within a step.
        flow: Function that returns the flow of a plan from its initial state.
        integrator: Function from a flow, its plan, `progress` and the number of steps after which
            `watch` is first called, to the function that integrates the flow.
        motion: Function from a flow, its plan, `progress` and a record in a checkpoint, to the
            function that integrates the plan of a scene without joint stops.
    """

    method: str
    degree: int
    flow: Callable[[Plan], Any]
    integrator: Callable[[Any, Plan, Progress | None, int | None], Integrate]
    motion: Callable[[Any, Plan, Progress | None, RunRecord | None], Callable[[], Motion]]
