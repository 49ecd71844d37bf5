"""Events along a motion: looked for as it is integrated, and located on its dense output.

Every step is looked at at its ends and in three places within; where an expression changes sign,
Brent's method finds the crossing on the dense output to the last bits of the time, so that what
is left is the error of the motion itself.  Scenes without events pay nothing for it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from ..common.arrays import Array, freeze
from ..common.errors import IntegrationError
from ..forces.event_expressions import Watched
from ..scene.scene import Scene
from ..system.state_fields import ShapeState, State, map_arrays
from .reduced_flow import Integrate, ReducedFlow, Segment

_PARTS = 4  # of a step, at whose ends the expressions are looked at
_SHOWN = 5  # times in a repr
_ONE = 1e-12  # of the time: what round-off holds apart
_EPS = 4.0 * float(np.finfo(float).eps)


@dataclass(frozen=True)
class Crossings:
    """The crossings of one event, in order; arrays are read-only.

    t: (K,) [s].  rising: (K,) whether the expression grows there.  states: those at these times,
    as the scene asks for them.
    """

    name: str
    t: Array
    rising: NDArray[np.bool_]
    states: State | ShapeState

    def __post_init__(self) -> None:
        freeze(self)

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        times = ", ".join(f"{t:g}" for t in self.t[:_SHOWN])
        more = ", …" if len(self) > _SHOWN else ""
        return f"Crossings({self.name!r}, {len(self)} at t = [{times}{more}] s)"


@dataclass(frozen=True)
class Found:
    """A crossing.  event: which of the scene's."""

    event: int
    t: float
    rising: bool


class Watch:
    """The events of one run.  found: crossings so far, in order of time within each piece."""

    def __init__(self, scene: Scene, flow: ReducedFlow, watched: Watched) -> None:
        """Take what is watched along a flow."""
        self._scene, self._flow, self._watched = scene, flow, watched
        self._events = scene.events_given
        self._signs = np.zeros(len(self._events))
        self._reached = -1.0
        self.found: list[Found] = []
        self.end: Found | None = None

    @property
    def may_end(self) -> bool:
        """Whether one of the events ends the motion."""
        return any(event.terminal for event in self._events)

    def look(self, piece: Segment) -> bool:
        """Find the crossings in a piece, from where it was looked at last; return whether it ends.

        Raises IntegrationError where an expression is not finite.
        """
        knots = piece.knots[piece.knots >= self._reached]
        if not knots.size or self.end is not None:
            return self.end is not None
        before = piece.knots[piece.knots < self._reached][-1:]
        whole = np.append(before, knots)
        steps = np.arange(len(whole))
        fine = np.interp(np.arange(_PARTS * (len(whole) - 1) + 1) / _PARTS, steps, whole)
        fine = fine[fine >= self._reached]
        values = self._values(piece, fine)
        for k, event in enumerate(self._events):
            self._cross(piece, k, event.direction, fine, values[k])
        self._reached = float(piece.knots[-1])
        self.found.sort(key=lambda found: found.t)
        ends = [found for found in self.found if self._events[found.event].terminal]
        if ends:
            self.end = ends[0]
            self.found = [found for found in self.found if found.t <= ends[0].t]
        return bool(ends)

    def _cross(self, piece: Segment, k: int, direction: int, t: Array, g: Array) -> None:
        """Find the crossings of one expression, whose values at times are g."""
        sign = self._signs[k]
        for j in range(len(t)):
            new = float(np.sign(g[j]))
            if new == 0.0:
                continue  # a touch, or the crossing comes after it
            if sign and new != sign and direction in (0, new):
                first = max(j - 1, 0)
                self.found.append(Found(k, self._root(piece, k, t[first], t[j]), rising=new > 0))
            sign = new
        self._signs[k] = sign

    def _root(self, piece: Segment, k: int, a: float, b: float) -> float:
        def value(t: float) -> float:
            return float(self._values(piece, np.array([t]))[k, 0])

        first, last = value(a), value(b)
        if a == b or first == 0.0 or (first > 0.0) == (last > 0.0):
            return float(a)
        return float(brentq(value, a, b, xtol=_EPS * max(abs(b), 1e-300), rtol=_EPS))

    def _values(self, piece: Segment, t: Array) -> Array:
        """Return the expressions (E, T) at times (T,) within a piece."""
        scene, flow, parameters = self._scene, self._flow, piece.parameters
        system = scene.system
        y = piece.at(t)
        states = flow.states(t, y, parameters)
        none, pose = np.zeros((system.r, len(t))), np.zeros((system.group.size, len(t)))
        relative, base = [none, none], [pose, none, none, none]
        if self._watched.sees_momentum:
            samples = [
                flow.sample(time, row, parameters) for time, row in zip(t.tolist(), y, strict=True)
            ]
            relative = [np.array([getattr(s, name) for s in samples]).T for name in ("xi", "mu")]
        if isinstance(states, State):
            space = (states.pose, states.xi, states.body_momentum, states.spatial_momentum)
            base = [part.T for part in space]
        columns = [t[None], states.x.T, states.xdot.T, *relative, *base]
        values = self._watched(columns, scene.parameters)
        bad = ~np.isfinite(values)
        if bad.any():
            k, j = np.argwhere(bad)[0]
            raise IntegrationError(
                f"event '{self._events[k].name}' is {values[k, j]} at t = {t[j]:g} s; its "
                "expression has to be defined along the motion"
            )
        return values


def ended(watch: Watch, piece: Segment, integrate: Integrate) -> list[Segment]:
    """Return what there is of the piece in which a terminal event lies, up to there.

    The last step is made anew, to the event, so that the end is the end of a step.
    """
    if watch.end is None or watch.end.t >= piece.knots[-1]:
        return [piece]
    end = watch.end.t
    knots = piece.knots[piece.knots < end]
    if not len(knots):
        return []  # it lies where the piece begins
    steps = min(piece.steps, len(knots) - 1)
    if end - knots[-1] <= _ONE * end:
        knots[-1] = end
        return [replace(piece, knots=knots, steps=steps)] if steps else []
    last = integrate(float(knots[-1]), end, piece.at(knots[-1:])[0], piece.parameters)
    return [replace(piece, knots=knots, steps=steps), last] if steps else [last]


def crossings(
    scene: Scene, found: list[Found], states: Callable[[Array], State | ShapeState]
) -> dict[str, Crossings]:
    """Return the crossings by the names of the events.  states: of a motion, at times (T,)."""
    out = {}
    for k, event in enumerate(scene.events_given):
        own = [each for each in found if each.event == k]
        t = np.array([each.t for each in own])
        rising = np.array([each.rising for each in own], dtype=bool)
        out[event.name] = Crossings(event.name, t, rising, states(t) if own else _none(states))
    return out


def _none(states: Callable[[Array], State | ShapeState]) -> State | ShapeState:
    """Return states at no times."""
    return map_arrays(lambda values: values[:0], states(np.zeros(1)))
