"""Trajectories: the motions of all members, as arrays with names, and each by itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...common.arrays import Array
from ...common.errors import IntegrationError
from ...scene.scene import Scene
from ...system.coordinates import Indices
from ...system.state_fields import FIELDS, ShapeState, State, axis_lengths, map_arrays
from ...system.system import System
from ..over_time import OverTime
from ..simulate import trajectory_of
from ..trajectory import Run, Trajectory, known_trajectory

if TYPE_CHECKING:
    from ..compiled.compiled_flow import CompiledFlows


@dataclass(frozen=True)
class Failure:
    """A member that did not come to its end.  time: the last it reached [s]."""

    member: int
    time: float
    reason: str


@dataclass(frozen=True)
class Batch:
    """Members that share a kernel and have run together.

    members: their indices, sorted.  flows: theirs; None of members that came from elsewhere.
    method: name of the integrator.  steps, evaluations: of each.  wall: seconds that one has
    taken in the mean.
    """

    members: Indices
    flows: CompiledFlows | None
    method: str
    steps: NDArray[np.int64]
    evaluations: NDArray[np.int64]
    wall: float


class Trajectories(OverTime):
    """Motions of one system, member first: the fields of State are (N, T, …).

    `trajectories[i]` is the Trajectory of one member.  Numbers are NaN at times that a member has
    not reached.

    t: (T,) [s].  y: (N, T, k) reduced states, NaN past the end of those that need fewer numbers.
    failures: the members that did not come to their end.
    """

    def __init__(
        self,
        scene_of: Callable[[int], Scene],
        y: Array,
        batches: Sequence[Batch],
        single: Mapping[int, Trajectory],
        failures: Sequence[Failure],
    ) -> None:
        """Take the scenes of members, their reduced states, and what makes full ones of them.

        single: the trajectories of members that ran by themselves.
        """
        first = scene_of(0)
        self._system, self._times, self.y = first.system, first.report_times, y
        self._wanted, self._scene_of = first.outputs == "all", scene_of
        self._batches, self._single, self.failures = tuple(batches), single, tuple(failures)
        self._failed = {failure.member: failure for failure in failures}

    def __reduce__(self) -> tuple[Any, ...]:
        # Kernels stay here: batches travel without their flows, beside the states made of them.
        batches = [replace(batch, flows=None) for batch in self._batches]
        parts = (self._scene_of, self.y, batches, dict(self._single), list(self.failures))
        return _travelled, (parts, self.outputs)

    def __len__(self) -> int:
        return len(self.y)

    def __repr__(self) -> str:
        return f"Trajectories({len(self)} of {len(self.t)} times, {len(self.failures)} failed)"

    def _repr_html_(self) -> str:
        from ...common.html import card, table

        rows = [(str(f.member), f.time, f.reason) for f in self.failures]
        return card(
            "Trajectories",
            f"{len(self)} of {len(self.t)} times to {self.t[-1]:g} s, {len(self.failures)} failed",
            table("members that did not come to their end", ["member", "t [s]", "reason"], rows),
        )

    @property
    def system(self) -> System:
        """The system that moves."""
        return self._system

    @property
    def _name(self) -> str:
        return "these members"

    @property
    def t(self) -> Array:
        """Report times, (T,) [s]."""
        return self._times

    @cached_property
    def outputs(self) -> State | ShapeState:
        """States of all members over the report times, (N, T, …); made when first looked at."""
        every = [self._states(member) for member in range(len(self))]
        return replace(map_arrays(lambda *values: np.stack(values), *every), t=self.t)

    def __getitem__(self, member: int) -> Trajectory:
        """Return the motion of one member.

        At the report times its states are those of the arrays here.  At others, and for balances,
        it is integrated by itself when that is first asked for; this agrees with the arrays
        within round-off times the stretch of the flow.
        Raises IntegrationError if it did not come to its end.
        """
        member = range(len(self))[member]
        if member in self._failed:
            failure = self._failed[member]
            raise IntegrationError(
                f"member {member} stopped at t = {failure.time:g} s: {failure.reason}"
            )
        if member in self._single:
            return self._single[member]
        scene, (batch, k) = self._scene_of(member), self._place(member)
        steps, evaluations = int(batch.steps[k]), int(batch.evaluations[k])
        run = Run("compiled", batch.method, steps, evaluations, batch.wall)
        return known_trajectory(scene, run, self._states(member), partial(trajectory_of, scene))

    def save(self, path: str | Path) -> None:
        """Write all members to a .npz or .zarr file (see save_members.py).  Raises InputError."""
        from .save_members import save

        scenes = [self._scene_of(member) for member in range(len(self))]
        save(self, scenes, {f.member: (f.time, f.reason) for f in self.failures}, path)

    def _states(self, member: int) -> State | ShapeState:
        """Return the states of one member over the report times, those of a failed one too."""
        if "outputs" in vars(self):  # which members that came from elsewhere have
            member_outputs = replace(self.outputs, t=np.broadcast_to(self.t, self.energy.shape))
            return map_arrays(lambda values: values[member], member_outputs)
        if member in self._single:
            return _up_to(self._single[member], self.t, self.system, wanted=self._wanted)
        if not any(member in batch.members for batch in self._batches):
            return _nothing(self.system, self.t, wanted=self._wanted)
        from ..compiled.compiled_flow import CompiledFlow

        batch, k = self._place(member)
        assert batch.flows is not None
        flow = CompiledFlow.of(batch.flows, k)
        return flow.states(self.t, self.y[member, :, : flow.y0.size], flow.numbers)

    def _place(self, member: int) -> tuple[Batch, int]:
        """Return the batch of a member, and its place there."""
        for batch in self._batches:
            k = int(np.searchsorted(batch.members, member))
            if k < len(batch.members) and batch.members[k] == member:
                return batch, k
        raise IndexError(member)


def _travelled(parts: tuple[Any, ...], outputs: State | ShapeState) -> Trajectories:
    """Return members that were pickled, with their states."""
    found = Trajectories(*parts)
    vars(found)["outputs"] = type(outputs)(**vars(outputs))  # read-only once more
    return found


def _up_to(traj: Trajectory, t: Array, system: System, *, wanted: bool) -> State | ShapeState:
    """Return the states of a motion at times (T,), NaN after an event has ended it."""
    known = traj.outputs
    if np.array_equal(known.t, t):
        return known
    reached = t <= traj.scene.end

    def fill(missing: Array, values: Array) -> Array:
        filled = missing.copy()
        filled[reached] = values
        return filled

    return replace(map_arrays(fill, _nothing(system, t, wanted=wanted), traj.at(t[reached])), t=t)


def _nothing(system: System, t: Array, *, wanted: bool) -> State | ShapeState:
    """Return states of a member that failed by itself: all NaN."""
    lengths, kind = axis_lengths(system), State if wanted else ShapeState
    fields = {
        name: np.full((len(t), lengths[axis]) if (axis := FIELDS[name].axis) else len(t), np.nan)
        for name in kind.__dataclass_fields__
    }
    return kind(**(fields | {"t": t}))
