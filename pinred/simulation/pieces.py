"""A motion in pieces: integration stops where a force is not smooth, or a controller is due."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import partial
from typing import Protocol

import numpy as np

from ..common.arrays import Array
from ..scene.scene import Scene
from ..system.system import Indices
from .state import Sample, ShapeState, State


class Flow(Protocol):
    """What a route knows of a scene: see ReducedFlow and CompiledFlow."""

    y0: Array
    numbers: Array

    def sample(self, t: float, y: Array, numbers: Array) -> Sample:
        """Return what forces see at one time.  numbers: those in the forces then."""

    def states(self, t: Array, y: Array, numbers: Array) -> State | ShapeState:
        """Return the full states at times (T,) of reduced states (T, k)."""


@dataclass(frozen=True)
class Piece:
    """One run of an integrator.

    knots: (K,) times of the ends of its steps, or of parts of long ones, from its start on [s].
    at: from times (T,) within to reduced states (T, k).  numbers: those in the forces, during
    it.
    """

    knots: Array
    at: Callable[[Array], Array]
    numbers: Array
    steps: int
    evaluations: int

    @property
    def end(self) -> float:
        """The time at which it ends [s]."""
        return float(self.knots[-1])


Solve = Callable[[float, float, Array], Piece]  # from start, end and state there


class Motion:
    """A solved scene: full states at any time."""

    def __init__(self, flow: Flow, pieces: Sequence[Piece], *, varies: bool = False) -> None:
        """Take the flow and its pieces, in order.

        varies: whether full states follow from reduced ones differently in each piece.
        """
        self._flow, self._pieces, self._varies = flow, pieces, varies
        self._ends = np.array([piece.end for piece in pieces])

    @property
    def steps(self) -> int:
        """Accepted steps."""
        return sum(piece.steps for piece in self._pieces)

    @property
    def evaluations(self) -> int:
        """Evaluations of the vector field."""
        return sum(piece.evaluations for piece in self._pieces)

    @property
    def knots(self) -> Array:
        """Times of the ends of all steps, (K,) [s]."""
        return np.unique(np.concatenate([piece.knots for piece in self._pieces]))

    def states(self, t: Array) -> State | ShapeState:
        """Return the full states at times (T,)."""
        y, last = self._reduced(t), self._pieces[-1].numbers
        if not self._varies:
            return self._flow.states(t, y, last)
        which = self._which(t)
        parts = {
            int(k): self._flow.states(t[which == k], y[which == k], self._pieces[k].numbers)
            for k in np.unique(which)
        }
        return _joined([parts[k] for k in sorted(parts)], np.argsort(which, kind="stable"))

    def samples(self, t: Array) -> list[tuple[Sample, Array]]:
        """Return what forces see at times (T,), and their numbers then."""
        y, which = self._reduced(t), self._which(t)
        return [
            (self._flow.sample(float(t[k]), y[k], numbers), numbers)
            for k, numbers in enumerate(self._pieces[j].numbers for j in which)
        ]

    def _which(self, t: Array) -> Indices:
        """Return the piece of each time; where one ends, the next begins only after it."""
        return np.minimum(np.searchsorted(self._ends, t, side="left"), len(self._pieces) - 1)

    def _reduced(self, t: Array) -> Array:
        if len(self._pieces) == 1:
            return self._pieces[0].at(t)
        y, which = np.empty((len(t), len(self._flow.y0))), self._which(t)
        for k in np.unique(which):
            y[which == k] = self._pieces[k].at(t[which == k])
        return y


def follow(scene: Scene, flow: Flow, solve: Solve) -> Motion:
    """Integrate a flow from stop to stop, setting the torques that controllers hold."""
    forces = scene.force_model
    t, y = 0.0, flow.y0
    stops = stops_of(scene)
    pieces: list[Piece] = []
    for stop in stops:
        see = partial(flow.sample, t, y, flow.numbers)
        begin_stretch(scene, flow.numbers, t, stop, see)
        piece = solve(t, stop, y)
        pieces.append(piece)
        t = stop
        if stop != stops[-1]:
            y = piece.at(np.array([stop]))[0]
    varies = forces is not None and len(forces.joints) > 0 and len(pieces) > 1
    return Motion(flow, pieces, varies=varies)


def _joined(parts: Sequence[State | ShapeState], order: Indices) -> State | ShapeState:
    """Return the states of all parts; order: (T,) where each row of them belongs."""
    kind = type(parts[0])
    back = np.argsort(order, kind="stable")
    columns = {
        field.name: np.concatenate([getattr(part, field.name) for part in parts])[back]
        for field in fields(kind)
    }
    return kind(**columns)


def begin_stretch(
    scene: Scene, numbers: Array, t: float, stop: float, see: Callable[[], Sample]
) -> None:
    """Set the numbers in the forces of a scene for the stretch from t to its stop.

    see: gives what forces see at t, and is called only if a controller is due.
    """
    forces = scene.force_model
    if forces is None:
        return
    numbers[forces.within] = 0.5 * (t + stop)
    # The first sample is at the start; the others at multiples of the period.
    due = [
        (controller, where)
        for controller, where in forces.held
        if abs(t / controller.period - round(t / controller.period)) < 1e-9
    ]
    if due:
        seen, names = see(), scene.system.shape_names
        for controller, where in due:
            numbers[where] = controller.sample(names, t, seen.x, seen.xdot, seen.mu)


def stops_of(scene: Scene) -> Array:
    """Return the times at which integration stops, the end of the scene last, (S,) [s]."""
    forces, end = scene.force_model, scene.end
    if forces is None:
        return np.array([end])
    times = [forces.breaks(end), np.array([end])]
    for controller, _ in forces.held:
        times.append(controller.period * np.arange(1, int(end / controller.period) + 1))
    inside = np.unique(np.concatenate(times))
    inside = inside[inside <= end]
    # What round-off holds apart is one stop; the end stays.
    apart = np.append(np.diff(inside) > 1e-12 * end, True)
    return np.asarray(inside[apart])
