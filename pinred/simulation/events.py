"""Events of a motion: detected during the integration and located on the dense output.

The sign changes of expressions of time alone are found by the search for switches of forces. Other
expressions are evaluated at the ends of each step and at three times inside it, between these
times where they do not predict the values there, and at extrema close to zero. If one changes sign,
Brent's method locates the crossing on the dense output to round-off. The crossing time is then as
accurate as the motion. Scenes without events cost nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array, FrozenArrays
from ..common.errors import IntegrationError
from ..common.names import NamedResults
from ..forces.force import Watched
from ..scene.scene import Scene
from ..system.coordinates import Indices
from ..system.state_fields import ShapeState, State, map_arrays
from .reduced_flow import Integrate, ReducedFlow, Segment

# An extremum is sampled if its predicted value has the other sign, or is below the error of the
# prediction. This error is a cubic that vanishes at the three samples, in units of the largest of
# them: this factor times the product of the distances, over the third power of the span of times.
# It is at most _CLOSE.
_CUBIC, _CLOSE = 5.0, 0.25
_BEYOND = 0.25  # largest distance beyond an end at which it is predicted, relative to three samples
_APART = 0.05  # least distance of a new time from a sample, relative to the interval


def extremum_times(times: Array, values: Array) -> Array:
    """Predict the times between samples at which an event is closest to zero.

    A parabola is placed through each sample that is closer to zero than its neighbours, and through
    the outer three samples at either end.

    Args:
        times: Times of the samples, (T,) sorted [s].
        values: Values of the events, (E, T).
    Returns:
        Sorted times where a further sample may have another sign, (K,) [s].
    """
    if len(times) < 3:
        return np.empty(0)
    sizes = np.abs(values)
    low = np.ones(values.shape, dtype=bool)
    low[:, 1:] &= sizes[:, 1:] <= sizes[:, :-1]
    low[:, :-1] &= sizes[:, :-1] <= sizes[:, 1:]
    event, at = np.nonzero(low)
    return _times_near(times, values, event, at) if len(at) else np.empty(0)


def _times_near(times: Array, values: Array, event: Indices, at: Indices) -> Array:
    """Return the times of extrema close to zero near samples with indices `at` of events."""
    middle = np.clip(at, 1, len(times) - 2)
    a, b, c = (values[event, middle + k] for k in (-1, 0, 1))
    t, left, right = times[middle], *(times[middle + k] - times[middle] for k in (-1, 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        slope_left, slope_right = (a - b) / left, (c - b) / right
        curvature = (slope_right - slope_left) / (right - left)
        slope = slope_left - curvature * left
        shift = -0.5 * slope / curvature
        extremum = b + 0.5 * slope * shift
    # At an end, the extremum lies between the end and its neighbour, up to errors of the parabola.
    least, most = np.where(at > middle, 0.0, left), np.where(at < middle, 0.0, right)
    beyond = np.where(at == middle, 0.0, _BEYOND * (right - left))
    inside = (shift > least - beyond) & (shift < most + beyond)
    shift = _apart(shift, left, right)
    size = np.maximum(np.maximum(np.abs(a), np.abs(b)), np.abs(c))
    sign = np.sign(values[event, at])
    product = np.abs(shift * (shift - left) * (shift - right))
    error = size * np.minimum(_CLOSE, _CUBIC * product / (right - left) ** 3)
    is_needed = inside & (a * b > 0.0) & (b * c > 0.0) & (curvature * sign > 0.0)
    with np.errstate(invalid="ignore"):  # infinite without curvature
        is_needed &= extremum * sign < error
    times_of_extrema: Array = np.unique(t[is_needed] + shift[is_needed])
    return times_of_extrema


def _apart(shift: Array, left: Array, right: Array) -> Array:
    """Return shifts from the middle one of three samples, at some distance from all three."""
    side = np.where(shift == 0.0, np.where(right > -left, right, left), 0.0)
    side = np.where(shift < 0.0, left, np.where(shift > 0.0, right, side))
    return np.asarray(side * np.clip(np.abs(shift / side), _APART, 1.0 - _APART))


_PARTS = 4  # Number of parts of a step; the expressions are evaluated at the ends of each part.
_HALVINGS = 6  # Largest number of times that a part is halved.
_EXTREMA = 12  # Largest number of samples near an extremum between two samples.
# A part is halved again if the cubic through four samples is off by this fraction of the largest.
_UNPREDICTED = 0.05
_SHOWN = 5  # Largest number of times that a repr shows.
_ROUND_OFF = 1e-12  # Times count as equal if they differ by less than this fraction of them.
_EPS = 4.0 * float(np.finfo(float).eps)


@checks_arguments
@dataclass(frozen=True)
class Crossings(FrozenArrays):
    """The zero crossings of one event, in order; arrays are read-only.

    Attributes:
        name: Name of the event.
        t: Times, (K,) [s].
        rising: Whether the expression increases, (K,).
        states: States at these times; a ShapeState if the scene leaves out the base.
    """

    name: str
    t: Array
    rising: NDArray[np.bool_]
    states: State | ShapeState

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        times = ", ".join(f"{t:g}" for t in self.t[:_SHOWN])
        more = ", …" if len(self) > _SHOWN else ""
        return f"Crossings({self.name!r}, {len(self)} at t = [{times}{more}] s)"


@dataclass(frozen=True)
class Crossing:
    """One zero crossing.

    Attributes:
        event: Index of the event in the scene.
        t: Time [s].
        rising: Whether the expression increases.
    """

    event: int
    t: float
    rising: bool


class RootSearch:
    """The search for sign changes of functions of the state in the steps of segments."""

    def __init__(self, signs: Array, sampled: Sequence[int]) -> None:
        """Prepare the search.

        Args:
            signs: Signs of the functions before the first step, (E,); zero if unknown.
            sampled: Indices of the functions that are searched.
        """
        self._signs, self._sampled = signs, list(sampled)
        self._reached = -1.0

    def values(self, segment: Segment, t: Array) -> Array:
        """Return the values (E, T) of all functions at times (T,) within a segment."""
        raise NotImplementedError

    def roots(self, segment: Segment, step_ends: Array) -> list[Crossing]:
        """Return the sign changes in the steps of a segment, function by function.

        Args:
            segment: The segment.
            step_ends: Ends of its new steps, (K,) [s].
        Returns:
            The sign changes; `event` is the index of the function.
        """
        fractions = np.arange(_PARTS * (len(step_ends) - 1) + 1) / _PARTS
        times = np.interp(fractions, np.arange(len(step_ends)), step_ends)
        times, values = self._sample(segment, times[times >= self._reached])
        crossings = []
        for k, values_of_event in zip(self._sampled, values, strict=True):
            changes, sign = _sign_changes(values_of_event, self._signs[k])
            for j in changes:
                time = self._root(segment, k, times[max(j - 1, 0)], times[j])
                crossings.append(Crossing(k, time, rising=bool(values_of_event[j] > 0.0)))
            self._signs[k] = sign
        return crossings

    def _sample(self, segment: Segment, times: Array) -> tuple[Array, Array]:
        """Return times with further ones between them, (T,), and the values at them, (E, T)."""
        values = self.values(segment, times)[self._sampled]
        starts = np.arange(len(times) - 1)
        for _ in range(_HALVINGS):
            if not starts.size:
                break
            middles = 0.5 * (times[starts] + times[starts + 1])
            predicted, size = _predict(times, values, starts, middles)
            actual = self.values(segment, middles)[self._sampled]
            wrong = (np.abs(actual - predicted) > _UNPREDICTED * size).any(axis=0)
            times = np.insert(times, starts + 1, middles)
            values = np.insert(values, starts + 1, actual, axis=1)
            # Samples of a fast oscillation may agree by chance, so neighbours are halved, too.
            first = (starts + np.arange(len(starts)))[wrong]
            near = np.unique(np.add.outer(first, np.arange(-2, 4)))
            starts = near[(near >= 0) & (near < len(times) - 1)]
        return self._with_extrema(segment, times, values)

    def _with_extrema(self, segment: Segment, times: Array, values: Array) -> tuple[Array, Array]:
        """Add samples where an event may reach zero and return between two samples."""
        for _ in range(_EXTREMA):
            new = extremum_times(times, values)
            if not new.size:
                break
            at = np.searchsorted(times, new)
            times = np.insert(times, at, new)
            values = np.insert(values, at, self.values(segment, new)[self._sampled], axis=1)
        return times, values

    def _root(self, segment: Segment, k: int, a: float, b: float) -> float:
        """Return the time between a and b at which the expression of event k is zero."""

        def value(t: float) -> float:
            return float(self.values(segment, np.array([t]))[k, 0])

        value_a, value_b = value(a), value(b)
        if a == b or value_a == 0.0 or (value_a > 0.0) == (value_b > 0.0):
            return float(a)
        from scipy.optimize import brentq

        return float(brentq(value, a, b, xtol=_EPS * max(abs(b), 1e-300), rtol=_EPS))


class Watch(RootSearch):
    """The detection of events during one run.

    Attributes:
        flow: The flow that is integrated.
        crossings: The crossings located so far, in order of time.
        end: The terminal crossing, or None as long as no terminal event has occurred.
    """

    def __init__(self, scene: Scene, flow: ReducedFlow, watched: Watched) -> None:
        """Prepare the detection.

        Args:
            scene: The scene with the events.
            flow: The flow that is integrated.
            watched: The compiled expressions of the events.
        """
        self._scene, self.flow, self._watched = scene, flow, watched
        self._events = scene.events_given
        count = len(self._events)
        super().__init__(np.zeros(count), [k for k in range(count) if k not in watched.of_time])
        self._of_time = self._find_times()
        self.crossings: list[Crossing] = []
        self.end: Crossing | None = None

    @property
    def may_end(self) -> bool:
        """Whether one of the events is terminal."""
        return any(event.terminal for event in self._events)

    def saved(self) -> dict[str, Any]:
        """Return the state of the detection as nested values, to continue the run later."""
        return {
            "signs": self._signs,
            "reached": self._reached,
            "crossings": [dict(vars(crossing)) for crossing in self.crossings],
        }

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Continue from a saved state."""
        self._signs, self._reached = saved["signs"], saved["reached"]
        self.crossings = [Crossing(**crossing) for crossing in saved["crossings"]]

    def look(self, segment: Segment) -> bool:
        """Locate the crossings in the new steps of a segment.

        Args:
            segment: The segment, as far as it is integrated.
        Returns:
            Whether a terminal event ends the motion.
        Raises:
            IntegrationError: An expression is not finite.
        """
        if self.end is not None or segment.end <= self._reached:
            return self.end is not None
        knots, reached = segment.knots, segment.end
        step_ends = knots[max(np.searchsorted(knots, self._reached) - 1, 0) :]
        self.crossings += [c for c in self._of_time if self._reached < c.t <= reached]
        if self._sampled:
            self.crossings += filter(self._counts, self.roots(segment, step_ends))
        self._reached = reached
        self.crossings.sort(key=lambda crossing: crossing.t)
        terminal = [c for c in self.crossings if self._events[c.event].terminal]
        if terminal:
            self.end = terminal[0]
            self.crossings = [c for c in self.crossings if c.t <= terminal[0].t]
        return bool(terminal)

    def _find_times(self) -> list[Crossing]:
        """Return the crossings of all expressions of time alone.

        Raises IntegrationError if one is not finite.
        """
        crossings = []
        numbers = self._watched.numbers(self._scene.parameters)
        for k, changes in self._watched.of_time.items():
            starts, values = changes.spans(self._scene.end, numbers)
            self._check_finite(values[None], starts, [k])
            changed, _ = _sign_changes(values, 0.0)
            crossings += [
                Crossing(k, float(starts[j]), rising=bool(values[j] > 0.0)) for j in changed
            ]
        return [c for c in crossings if self._counts(c)]

    def _counts(self, crossing: Crossing) -> bool:
        """Return whether a crossing has the direction that its event requests."""
        direction = self._events[crossing.event].direction
        return direction == 0 or (direction > 0) == crossing.rising

    def values(self, segment: Segment, t: Array) -> Array:
        """Return the values (E, T) of all expressions at times (T,) within a segment."""
        scene, flow, parameters = self._scene, self.flow, segment.parameters
        system = scene.system
        y = segment.at(t)
        states = flow.states(t, y, parameters)
        unknown, pose = np.zeros((system.r, len(t))), np.zeros((system.group.size, len(t)))
        relative, base = [unknown, unknown], [pose, unknown, unknown, unknown]
        if self._watched.sees_momentum:
            samples = [
                flow.sample(time, y_t, parameters) for time, y_t in zip(t.tolist(), y, strict=True)
            ]
            relative = [np.array([getattr(s, name) for s in samples]).T for name in ("xi", "mu")]
        if isinstance(states, State):
            space = (states.pose, states.xi, states.body_momentum, states.spatial_momentum)
            base = [array.T for array in space]
        columns = [t[None], states.x.T, states.xdot.T, *relative, *base]
        values = self._watched(columns, scene.parameters)
        self._check_finite(values, t, range(len(values)))
        return values

    def _check_finite(self, values: Array, t: Array, events: Sequence[int]) -> None:
        """Raise IntegrationError if a value (E, T) of events at times (T,) is not finite."""
        bad = ~np.isfinite(values)
        if bad.any():
            k, j = np.argwhere(bad)[0]
            raise IntegrationError(
                f"event '{self._events[events[k]].name}' is {values[k, j]} at t = {t[j]:g} s; its "
                "expression has to be defined along the motion"
            )


def _sign_changes(values: Array, sign: float) -> tuple[Indices, float]:
    """Return the indices of values (T,) with another sign than the last one that is not zero.

    Args:
        values: Values in order of time; `sign` is the sign before them, zero if there is none.
        sign: See `values`.
    Returns:
        Indices, and the last sign.
    """
    # Where a value is zero, the expression only touches zero, or crosses zero in a later part.
    at = np.flatnonzero(values)
    signs = np.append(sign, np.sign(values[at]))
    return at[signs[1:] * signs[:-1] < 0.0], float(signs[-1])


def _predict(times: Array, values: Array, left: Indices, middles: Array) -> tuple[Array, Array]:
    """Interpolate values at the middles of intervals by the polynomial through four samples.

    Args:
        times: Times of the samples, (T,) [s].
        values: Values of the samples, (E, T).
        left: Indices of the left ends of intervals, (P,).
        middles: Middles of the intervals, (P,) [s].
    Returns:
        Values at the middles, and the largest absolute values of the samples used, (E, P) each.
    """
    count = min(4, len(times))
    window = np.clip(left - 1, 0, len(times) - count)[:, None] + np.arange(count)
    nodes, samples = times[window], values[:, window]
    weights = np.ones_like(nodes)
    for i in range(count):
        for j in range(count):
            if i != j:
                weights[:, i] *= (middles - nodes[:, j]) / (nodes[:, i] - nodes[:, j])
    return (samples * weights).sum(axis=2), np.abs(samples).max(axis=2)


def cut_at(end_time: float, segment: Segment, integrate: Integrate) -> list[Segment]:
    """Return the parts of a segment up to a time.

    The last step is integrated again, so that it ends at this time.

    Args:
        end_time: The time, such as that of a terminal event [s].
        segment: The segment.
        integrate: Integrator of segments.
    Returns:
        One or two segments, or none if the time is the start of the segment.
    """
    if end_time >= segment.end:
        return [segment]
    knots = segment.knots
    count = int(np.searchsorted(knots, end_time))
    if not count:
        return []
    last_end = float(knots[count - 1])
    if end_time - last_end <= _ROUND_OFF * end_time:
        shorter = segment.until(count, end_time)
        return [shorter] if shorter.steps else []
    y = segment.at(knots[count - 1 : count])[0]
    last_step = integrate(last_end, end_time, y, segment.parameters)
    shorter = segment.until(count, last_end)
    return [shorter, last_step] if shorter.steps else [last_step]


def crossings_by_event(
    scene: Scene, crossings: list[Crossing], states: Callable[[Array], State | ShapeState]
) -> NamedResults[Crossings]:
    """Return the crossings of each event by its name.

    Args:
        scene: The scene with the events.
        crossings: Crossings of all events, in order of time.
        states: Function from times (T,) to the states of the motion.
    Returns:
        {event name: its crossings, with the states at these times}.
    """
    by_name = {}
    for k, event in enumerate(scene.events_given):
        selected = [crossing for crossing in crossings if crossing.event == k]
        t = np.array([crossing.t for crossing in selected])
        rising = np.array([crossing.rising for crossing in selected], dtype=bool)
        event_states = states(t) if selected else _no_states(states)
        by_name[event.name] = Crossings(event.name, t, rising, event_states)
    return NamedResults("event", by_name)


def _no_states(states: Callable[[Array], State | ShapeState]) -> State | ShapeState:
    """Return states with a time axis of length zero."""
    return map_arrays(lambda values: values[:0], states(np.zeros(1)))
