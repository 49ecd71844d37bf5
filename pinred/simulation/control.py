"""Controllers in a run: when each is called, what is held until when, and the record of it.

A `Control` calls them, and so gives a motion its record; a `Replay` takes what they gave from
that record, so that another simulation runs under the same actions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..common.arrays import Array, read_only
from ..forces.named_arrays import Vector
from ..scene.scene import Scene
from ..system.force_interface import SeenState
from .sample import Sample

_ONE = 1e-12  # of the whole time: what round-off holds apart is one stop
_DUE = 1e-9  # of a period

See = Callable[[], Sample]


@dataclass(frozen=True)
class ControlAction:
    """One call of a controller, and what it gave.

    t: [s].  controller: its name.  torque: by joint, before its limit [N·m | N].  wrench: (r,) on
    the base in its own frame, [linear; angular], or None.  width: for how long it is held [s];
    None to its next call.  seen: the state that it was given, with that of the base.
    """

    t: float
    controller: str
    torque: Mapping[str, float]
    wrench: Array | None
    width: float | None
    seen: Sample


class Actions(Protocol):
    """The actions of controllers in a run: a Control or a Replay."""

    def begin(self, numbers: Array, t: float, stop: float, see: See) -> float:
        """Set the numbers in the forces for the stretch from t on, and return where it ends.

        That is at `stop` or before.  see: gives what forces see at t, and is called only if a
        controller is due.
        """


class Control:
    """The controllers of one run of a scene, each with its state; it is used once.

    calls: what they have given so far.
    """

    def __init__(self, scene: Scene) -> None:
        """Take copies of their first states."""
        self._scene, self._forces = scene, scene.force_model
        held = [] if self._forces is None else self._forces.held
        self._states = [deepcopy(c.state0) if c.keeps_state else None for c, _ in held]
        self._called = [-1] * len(held)
        self._until = [np.inf] * len(held)
        self.calls: list[ControlAction] = []

    def begin(self, numbers: Array, t: float, stop: float, see: See) -> float:
        """Do as Actions.begin, calling the controllers that are due at t."""
        forces = self._forces
        if forces is None:
            return stop
        near, seen = _ONE * self._scene.end, None
        for k, (controller, where) in enumerate(forces.held):
            if self._until[k] <= t + near:  # the end of a pulse
                numbers[where], self._until[k] = 0.0, np.inf
            # The first call is at the start; the others at multiples of the period.
            count = round(t / controller.period)
            if count > self._called[k] and abs(t / controller.period - count) < _DUE:
                self._called[k] = count
                seen = see() if seen is None else seen
                numbers[where], self._until[k] = self._call(k, t, seen)
        until = min([stop, *(u for u in self._until if u < stop - near)])
        numbers[forces.within] = 0.5 * (t + until)
        return until

    def _call(self, k: int, t: float, seen: Sample) -> tuple[Array, float]:
        """Return the numbers that a controller gives at t, and until when they are held."""
        forces, system = self._forces, self._scene.system
        assert forces is not None
        controller, _ = forces.held[k]
        names, r = system.shape_names, system.r
        given, self._states[k] = controller.sample(
            measured(t, seen, names), seen.mu, self._states[k]
        )
        held = controller.held(given, names, r, t)
        joints = controller.driven(names)
        torque = dict(zip(joints, held.values.tolist(), strict=False))
        wrench = read_only(held.values[len(joints) :].copy()) if controller.wrench else None
        self.calls.append(ControlAction(t, controller.name, torque, wrench, held.width, seen))
        if held.width is None:
            return held.values, np.inf
        if held.width <= _ONE * self._scene.end:
            return np.zeros_like(held.values), np.inf
        return held.values, t + held.width


def measured(t: float, seen: Sample, names: tuple[str, ...]) -> SeenState:
    """Return what controllers are given: numbers of their own, with joints by name."""
    x, xdot, base = Vector.of(seen.x, names, "x"), Vector.of(seen.xdot, names, "xdot"), seen.base
    if base is None:  # left out, which a scene allows only where nobody looks at it
        return SeenState(t, x, xdot, None, None, None, None)
    space = (np.array(part) for part in (base.pose, base.xi, base.mu, base.J))
    return SeenState(t, x, xdot, *space)


class Replay:
    """The actions of a motion, again: the numbers that were in the forces, stretch by stretch."""

    def __init__(self, ends: Array, numbers: Sequence[Array]) -> None:
        """Take the ends of the stretches (S,) [s] and the numbers (p,) in each."""
        self._ends, self._numbers = ends, numbers

    def begin(self, numbers: Array, t: float, stop: float, see: See) -> float:  # noqa: ARG002
        """Do as Actions.begin."""
        k = min(int(np.searchsorted(self._ends, t, side="right")), len(self._ends) - 1)
        numbers[:] = self._numbers[k]
        return min(stop, float(self._ends[k])) if self._ends[k] > t else stop
