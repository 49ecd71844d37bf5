"""Calls of controllers during a simulation, recorded so that they can be replayed.

A `Control` calls the controllers of a scene.  A `Replay` repeats the actions of a motion, so that
another simulation runs under the same actions.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..common.arrays import Array, read_only
from ..common.errors import InputError
from ..common.names import brief
from ..forces.columns import Vector
from ..forces.force_numbers import BaseInSpace
from ..forces.switch_times import time_within
from ..scene.scene import Scene
from ..system.force_interface import SeenState
from ..system.system import System
from .reduced_flow import Sample

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
        near, seen = _ROUND_OFF * self._scene.end, None
        for k, (controller, where) in enumerate(forces.held):
            if self._until[k] <= t + near:  # the pulse has ended
                numbers[where], self._until[k] = 0.0, np.inf
            # Calls are at multiples of the period, the first call at t = 0.
            count = round(t / controller.period)
            if count > self._called[k] and abs(t / controller.period - count) < _DUE:
                self._called[k] = count
                seen = see() if seen is None else seen
                numbers[where], self._until[k] = self._call(k, t, seen)
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
    seen = vars(action.seen) | {"base": action.seen.base and dict(vars(action.seen.base))}
    return vars(action) | {"torque": dict(action.torque), "seen": seen}


def _restored_action(saved: Mapping[str, Any]) -> ControlAction:
    seen = dict(saved["seen"])
    seen["base"] = seen["base"] and BaseInSpace(**seen["base"])
    wrench = saved["wrench"]
    wrench = wrench if wrench is None else read_only(wrench)
    return ControlAction(**{**saved, "wrench": wrench, "seen": Sample(**seen)})


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
