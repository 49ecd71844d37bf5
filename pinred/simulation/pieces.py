"""A motion in pieces: integration stops where a force is not smooth, or a controller is due."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ..common.arrays import Array
from ..system.coordinates import Indices
from ..system.state_fields import ShapeState, State, map_arrays
from .control import Control, ControlAction, Replay
from .events import Found, Watch, ended
from .piece import Flow, Integrate, Piece
from .plan import Plan
from .sample import Sample


@dataclass(frozen=True)
class Changes:
    """Reduced states y (T, k) and their rates (T, k), with the pieces (T,) that they are in."""

    which: Indices
    y: Array
    rates: Array


class Motion:
    """A solved scene: full states at any time."""

    def __init__(
        self,
        flow: Flow,
        pieces: Sequence[Piece],
        *,
        varies: bool = False,
        actions: Sequence[ControlAction] = (),
        watch: Watch | None = None,
    ) -> None:
        """Take the flow and its pieces, in order.

        varies: whether full states follow from reduced ones differently in each piece.
        actions: those of controllers on the way.  watch: what has looked for events.
        """
        self._flow, self._pieces, self._varies = flow, pieces, varies
        self.actions = tuple(actions)
        self.found: list[Found] = [] if watch is None else watch.found
        self.ended_by = None if watch is None else watch.end
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

    @property
    def replay(self) -> Replay:
        """The actions of the controllers, for another simulation."""
        return Replay(self._ends, [piece.numbers for piece in self._pieces])

    def states(self, t: Array) -> State | ShapeState:
        """Return the full states at times (T,)."""
        y, last = self.reduced(t), self._pieces[-1].numbers
        if not self._varies:
            return self._flow.states(t, y, last)
        which = self._which(t)
        parts = {
            int(k): self._flow.states(t[which == k], y[which == k], self._pieces[k].numbers)
            for k in np.unique(which)
        }
        return joined([parts[k] for k in sorted(parts)], np.argsort(which, kind="stable"))

    def numbers(self, t: Array) -> list[Array]:
        """Return the numbers (p,) in the forces at each of times (T,)."""
        return [self._pieces[k].numbers for k in self._which(t)]

    def changes(self, t: Array) -> Changes:
        """Return reduced states and their rates at times (T,)."""
        y, which = self.reduced(t), self._which(t)
        rates = np.empty_like(y)
        for k in np.unique(which):
            some = which == k
            rates[some] = self._flow.rates(t[some], y[some], self._pieces[k].numbers)
        return Changes(which, y, rates)

    def beside(self, t: Array, changes: Changes, s: Array) -> Array:
        """Return velocities (T, n), body twist and shape, as if time had gone on by s (T,).

        Where the reduced states would be if they went on at their rates.
        """
        y, which = changes.y + s[:, None] * changes.rates, changes.which
        found: dict[int, Array] = {}
        for k in np.unique(which):
            some = which == k
            state = self._flow.states((t + s)[some], y[some], self._pieces[k].numbers)
            assert isinstance(state, State)
            found[int(k)] = np.hstack([state.xi, state.xdot])
        rows = np.concatenate([found[k] for k in sorted(found)])
        return rows[np.argsort(np.argsort(which, kind="stable"), kind="stable")]

    def samples(self, t: Array) -> list[tuple[Sample, Array]]:
        """Return what forces see at times (T,), and their numbers then."""
        y, which = self.reduced(t), self._which(t)
        return [
            (self._flow.sample(float(t[k]), y[k], numbers), numbers)
            for k, numbers in enumerate(self._pieces[j].numbers for j in which)
        ]

    def _which(self, t: Array) -> Indices:
        """Return the piece of each time; where one ends, the next begins only after it."""
        return np.minimum(np.searchsorted(self._ends, t, side="left"), len(self._pieces) - 1)

    def reduced(self, t: Array) -> Array:
        """Return the reduced states at times (T,), (T, k)."""
        if len(self._pieces) == 1:
            return self._pieces[0].at(t)
        y, which = np.empty((len(t), len(self._flow.y0))), self._which(t)
        for k in np.unique(which):
            y[which == k] = self._pieces[k].at(t[which == k])
        return y


def follow(plan: Plan, flow: Flow, integrate: Integrate) -> Motion:
    """Integrate a flow from stop to stop, setting the torques that controllers hold."""
    t, y = 0.0, flow.y0
    control, watched = Control(plan.scene), plan.scene.watched
    watch = None if watched is None else Watch(plan.scene, flow, watched)
    stopping = watch.look if watch is not None and watch.may_end else None
    pieces: list[Piece] = []
    for stop in plan.stops.tolist():
        while t < stop:
            until = control.begin(flow.numbers, t, stop, partial(flow.sample, t, y, flow.numbers))
            piece = integrate(t, until, y, stopping)
            if watch is not None and watch.look(piece):
                pieces += ended(watch, piece, integrate)
                return _motion(plan, flow, pieces, control, watch)
            pieces.append(piece)
            t = until
            if t != plan.stops[-1]:
                y = piece.at(np.array([t]))[0]
    return _motion(plan, flow, pieces, control, watch)


def _motion(
    plan: Plan, flow: Flow, pieces: Sequence[Piece], control: Control, watch: Watch | None
) -> Motion:
    varies = bool(plan.acting.driven) and len(pieces) > 1
    return Motion(flow, pieces, varies=varies, actions=control.calls, watch=watch)


def joined(parts: Sequence[State | ShapeState], order: Indices) -> State | ShapeState:
    """Return the states of all parts; order: (T,) where each row of them belongs."""
    back = np.argsort(order, kind="stable")
    return map_arrays(lambda *values: np.concatenate(values)[back], *parts)
