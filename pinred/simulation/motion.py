"""Motion: the segments of an integrated scene, with located events and controller calls.

Integration stops where a force is not smooth, or where a controller is due.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import pairwise
from typing import Any

import numpy as np

from ..common.arrays import Array, read_only
from ..common.waiting import Progress
from ..forces.switch_times import time_within
from ..scene.stop import Bound
from ..system.coordinates import Indices
from ..system.state_fields import ShapeState, State, map_arrays
from .checkpoint import Part, RunRecord
from .control import Control, ControlAction, Replay
from .events import Crossing, Watch, cut_at
from .impacts import ImpactTable
from .plan import Plan
from .reduced_flow import Integrate, ReducedFlow, Sample, Segment, map_samples


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
        for k, rows in self._by_segment(self._which(t)):
            states = self.segments[k].at(t[rows])
            y[rows, : states.shape[1]] = states
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
        parts, order = [], []
        for k, rows in self._by_segment(which):
            parameters = self.segments[k].parameters
            parts.append(self.flow_of(k).samples(t[rows], y[rows], parameters))
            order.append(rows)
        inverse_order = np.argsort(np.concatenate(order))
        return map_samples(lambda columns: np.concatenate(columns)[inverse_order], parts), numbers

    def numbers(self, t: Array) -> list[Array]:
        """Return the force parameters (p,) at each of times (T,)."""
        return [self._numbers(k) for k in self._which(t)]

    def changes(self, t: Array) -> Changes:
        """Return reduced states and their rates at times (T,), without round-off of the time."""
        y, which = np.array(self.reduced(t)), self._which(t)
        rates = np.zeros_like(y)
        for k, rows in self._by_segment(which):
            flow, parameters = self.flow_of(k), self.segments[k].parameters
            states = y[rows, : len(flow.y0)]
            states[:, flow.clock] = t[rows, None]
            y[rows, : len(flow.y0)] = states
            rates[rows, : len(flow.y0)] = flow.rates(t[rows], states, parameters)
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
        parts, order = [], []
        for k, rows in self._by_segment(which):
            parts.append(self.flow_of(k).states(t[rows], y[rows], self.segments[k].parameters))
            order.append(rows)
        inverse_order = np.argsort(np.concatenate(order))
        return map_arrays(lambda *columns: np.concatenate(columns)[inverse_order], *parts)

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


@dataclass(frozen=True)
class Solver:
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
