"""Trajectories: the motions of all members, as arrays or one by one, and their files.

RecordedMembers are the motions that `Trajectories.save` wrote, read from a file.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array
from ...common.errors import InputError, IntegrationError, LoadError
from ...common.files import check_path, write_atomic
from ...common.names import listed, nearest, quoted, quoted_path
from ...lie.groups import GROUPS
from ...scene.scene import Scene
from ...system.coordinates import Indices
from ...system.state_fields import FIELDS, ShapeState, State, arrays_of, axis_lengths, map_arrays
from ...system.system import System, nominal
from ..impacts import MemberImpacts, impact_arrays, member_table_in
from ..read_recording import (
    MOST_BYTES,
    ORIGIN,
    RecordedStates,
    Recording,
    load_recorded_robot,
    read_arrays,
)
from ..saved_states import OverTime, read_zarr, robot_arrays, write_zarr
from ..simulate import trajectory_of
from ..trajectory import Cost, Trajectory

if TYPE_CHECKING:
    from ..compiled.compiled_flow import CompiledFlow


@checks_arguments
@dataclass(frozen=True)
class Failure:
    """A member of simulate_many that did not reach its end time.

    Attributes:
        member: Index of the member.
        time: Last time that it reached [s].
        reason: Description of the cause.
        rejected: Whether its values were rejected, so that it was never simulated.
    """

    member: int
    time: float
    reason: str
    rejected: bool = False


@dataclass(frozen=True)
class Batch:
    """Members that were integrated together with one kernel.

    Attributes:
        members: Sorted indices of the members, (N,).
        flow: Flow of the members; None for unpickled members.
        method: Name of the integrator.
        y: Reduced states at the report times, (N, T, k); NaN at times that were not reached.
        steps: Number of accepted steps of each member, (N,).
        evaluations: Number of evaluations of the vector field for each member, (N,).
        failures: Members that did not reach their end time.
        wall: Mean wall time of one member [s].
        device: "cuda" if CUDA devices also compute the states, None for the CPU.
    """

    members: Indices
    flow: CompiledFlow | None
    method: str
    y: Array
    steps: NDArray[np.int64]
    evaluations: NDArray[np.int64]
    failures: list[Failure]
    wall: float
    device: str | None = None


@checks_arguments
class Trajectories(OverTime):
    """Motions of one system; the fields of State have shape (N, T, …), with members first.

    `trajectories[i]` is the Trajectory of one member.  Entries are NaN at times that a member did
    not reach, because it failed or because a terminal event ended it.

    Attributes:
        failures: Members that failed before their end time.
    """

    def __init__(
        self,
        members: tuple[int, Callable[[int], Scene]],
        batches: Sequence[Batch],
        single: Mapping[int, Trajectory],
        failures: Sequence[Failure],
        outputs: State | ShapeState | None = None,
        impacts: MemberImpacts | None = None,
    ) -> None:
        """Collect the results of all members.

        Args:
            members: Number of members, and the function that returns the scene of a member.
            batches: Members that were integrated together.
            single: Trajectories of the members that were integrated one by one.
            failures: Members that did not reach their end time.
            outputs: States of all members, if already computed.
            impacts: Impacts of all members, if already collected.
        """
        self._count, self._scene_of = members
        self._batches, self._single, self.failures = tuple(batches), single, tuple(failures)
        self._failed = {failure.member: failure for failure in failures}
        if outputs is not None:  # the constructor of a state makes unpickled arrays read-only
            vars(self)["outputs"] = type(outputs)(**arrays_of(outputs))
        if impacts is not None:
            vars(self)["impacts"] = impacts

    def __reduce__(self) -> tuple[Any, ...]:
        # Kernels cannot be pickled, so pickle the states instead of the flows.
        batches = [replace(batch, flow=None) for batch in self._batches]
        members, single = (self._count, self._scene_of), dict(self._single)
        states = self.outputs, self.impacts
        return Trajectories, (members, batches, single, self.failures, *states)

    def __len__(self) -> int:
        return self._count

    def __repr__(self) -> str:
        return f"Trajectories({len(self)} of {len(self.t)} times, {len(self.failures)} failed)"

    def _repr_html_(self) -> str:
        from ...common.html import card, table

        entries = [(str(f.member), f.time, f.reason) for f in self.failures]
        return card(
            "Trajectories",
            f"{len(self)} of {len(self.t)} times to {self.t[-1]:g} s, {len(self.failures)} failed",
            table("members that did not reach their end", ["member", "t [s]", "reason"], entries),
        )

    @cached_property
    def _first_scene(self) -> Scene:
        """The scene of the first member."""
        return self._scene_of(0)

    @property
    def _wants_all(self) -> bool:
        """Whether the base motion is an output."""
        return self._first_scene.outputs == "all"

    @property
    def _missing(self) -> State | ShapeState:
        """The states of a member that was never simulated."""
        return _missing_states(self.system, self.t, wanted=self._wants_all)

    @property
    def system(self) -> System:
        """The system that moves."""
        return self._first_scene.system

    @property
    def _name(self) -> str:
        return "these members"

    @property
    def t(self) -> Array:
        """Report times, (T,) [s]."""
        return self._first_scene.report_times

    @cached_property
    def y(self) -> Array:
        """Reduced states, (N, T, k); padded with NaN for members with fewer entries."""
        batches = [(batch.members, batch.y) for batch in self._batches]
        for member, traj in self._single.items():
            reached = self.t[self.t <= traj.scene.end]
            reduced = traj.motion.reduced(reached)
            missing = np.full((len(self.t) - len(reached), reduced.shape[1]), np.nan)
            batches.append((np.array([member]), np.concatenate([reduced, missing])[None]))
        if len(batches) == 1 and len(batches[0][1]) == len(self):
            return batches[0][1]
        width = max((y.shape[2] for _, y in batches), default=0)
        combined = np.full((len(self), len(self.t), width), np.nan)
        for members, y in batches:
            combined[members, :, : y.shape[2]] = y
        return combined

    @cached_property
    def impacts(self) -> MemberImpacts:
        """Impacts of all members at joint stops, with a column of members."""
        alone = self._single.items()
        tables = {member: traj.impacts for member, traj in alone if traj.scene.bounds}
        return MemberImpacts.of(tables, len(self), self.system.r)

    @cached_property
    def outputs(self) -> State | ShapeState:
        """States of all members at the report times, (N, T, …), computed at first access."""
        state_type = State if self._wants_all else ShapeState
        names = [name for name in state_type.__dataclass_fields__ if name != "t"]
        return state_type(t=self.t, **self.fields(names))

    def fields(self, names: Sequence[str]) -> dict[str, Array]:
        """Compute some fields of the states of all members, without the others.

        Args:
            names: Names of fields of State, except the time.
        Returns:
            {name: (N, T, …)}.
        Raises:
            InputError: A name is unknown.
        """
        state_type = State if self._wants_all else ShapeState
        valid = [name for name in state_type.__dataclass_fields__ if name != "t"]
        for name in names:
            if name not in valid:
                raise InputError(
                    f"names: there is no field {quoted(name)}; {nearest(name, valid)}the fields "
                    f"are {listed(valid, 60)}"
                )
        if "outputs" in vars(self):
            return {name: getattr(self.outputs, name) for name in names}
        missing = arrays_of(self._missing)
        fields = {name: np.empty((len(self), *missing[name].shape)) for name in names}
        alone = np.ones(len(self), bool)
        for batch in self._batches:
            assert batch.flow is not None
            batch.flow.fill_states(self.t, batch.y, batch.members, fields, batch.device)
            alone[batch.members] = False
        for member in np.flatnonzero(alone).tolist():
            states = self._states(member)
            for name, field in fields.items():
                field[member] = getattr(states, name)
        return fields

    def __getitem__(self, member: int) -> Trajectory:
        """Return the motion of one member.

        The states at the report times are taken from the arrays.  For other times and for balances
        the member is simulated again at first use.  The repeated motion agrees with the arrays
        within round-off times the growth along the motion, or within the tolerance if functions of
        time in forces change within less than a step.

        Args:
            member: Index of the member.
        Returns:
            The trajectory.
        Raises:
            IntegrationError: The member did not reach its end time.
        """
        member = range(len(self))[member]
        if member in self._failed:
            failure = self._failed[member]
            raise IntegrationError(
                f"member {member} stopped at t = {failure.time:g} s: {failure.reason}"
            )
        if member in self._single:
            return self._single[member]
        scene, place = self._scene_of(member), self._place(member)
        assert place is not None
        batch, k = place
        steps, evaluations = int(batch.steps[k]), int(batch.evaluations[k])
        run = Cost("compiled", batch.method, steps, evaluations, batch.wall)
        again = partial(trajectory_of, scene)
        return Trajectory(scene, None, run, again, self._states(member))

    def save(self, path: str | Path) -> None:
        """Write the states of all members to a file; no partial file remains after a failure.

        The file contains `t`, (T,), one array (N, T, …) for each other field of State, and the
        robot as `Trajectory.save` writes it.  For each member there are `failure`, (N,), the reason
        for its failure or "", and `reached`, (N,), the last time [s].  `impact_member`, `impact_t`
        and so on are the columns of the impacts at joint stops, if there are any.  `gravity` is
        (N, 3), and `parameter_values`, (N, …), include the parameters of forces.  Both are NaN for
        members whose values were rejected.

        A .zarr folder names its dimensions, and replaces an existing one.  `read_members` and
        `xarray.open_zarr(path, consolidated=False)` read it.

        An InputError is raised for another suffix or a missing folder, an OutputError if writing
        fails, and a MissingPackageError if zarr is not installed.

        Args:
            path: Path of the file; its suffix, .npz or .zarr, selects the format.
        """
        path = check_path(path, (".npz", ".zarr"), folders=(".zarr",))
        reasons, reached = [""] * len(self), np.full(len(self), float(self.t[-1]))
        for failure in self.failures:
            reasons[failure.member], reached[failure.member] = failure.reason, failure.time
        arrays = {
            **robot_arrays(nominal(self.system)),
            **arrays_of(self.outputs),
            **impact_arrays(self.impacts),
            "failure": np.array(reasons, dtype=str),
            "reached": reached,
            **_scene_arrays([self._scene_of(member) for member in range(len(self))]),
        }
        rejected = [failure.member for failure in self.failures if failure.rejected]
        for name in {"gravity", "parameter_values"} & set(arrays):
            arrays[name][rejected] = np.nan
        if path.suffix == ".npz":
            write_atomic(path, lambda file: np.savez_compressed(file, **arrays))
        else:
            write_zarr(path, arrays, self.system)

    def _states(self, member: int) -> State | ShapeState:
        """Return the states of one member at the report times; NaN after the member has failed."""
        if "outputs" in vars(self):  # Unpickled members have states but no flows.
            member_outputs = replace(self.outputs, t=np.broadcast_to(self.t, self.energy.shape))
            return map_arrays(lambda values: values[member], member_outputs)
        if member in self._single:
            return _up_to(self._single[member], self.t, self.system, wanted=self._wants_all)
        place = self._place(member)
        if place is None:
            return self._missing
        batch, k = place
        assert batch.flow is not None
        if batch.device is None:
            return batch.flow[k].states(self.t, batch.y[k])
        # Devices round otherwise, and these states are those of the arrays.
        at, missing = slice(k, k + 1), self._missing
        fields = {n: np.empty((1, *a.shape)) for n, a in arrays_of(missing).items() if n != "t"}
        batch.flow[at].fill_states(self.t, batch.y[at], np.zeros(1, int), fields, batch.device)
        return type(missing)(t=self.t, **{name: values[0] for name, values in fields.items()})

    def _place(self, member: int) -> tuple[Batch, int] | None:
        """Return the batch of a member, and the index of the member in that batch, if any."""
        for batch in self._batches:
            k = int(np.searchsorted(batch.members, member))
            if k < len(batch.members) and batch.members[k] == member:
                return batch, k
        return None


def _up_to(traj: Trajectory, t: Array, system: System, *, wanted: bool) -> State | ShapeState:
    """Return the states of a motion at times (T,); NaN after the event that ended it."""
    if np.array_equal(traj.outputs.t, t):
        return traj.outputs
    reached = t <= traj.scene.end
    if not reached.any():
        return _missing_states(system, t, wanted=wanted)

    indices = np.searchsorted(traj.outputs.t, t[reached])

    def fill(missing: Array, values: Array) -> Array:
        filled = missing.copy()
        filled[reached] = values[indices]
        return filled

    return replace(map_arrays(fill, _missing_states(system, t, wanted=wanted), traj.outputs), t=t)


def _missing_states(system: System, t: Array, *, wanted: bool) -> State | ShapeState:
    """Return states at times (T,) that are all NaN, for a member that failed one by one."""
    lengths, state_class = axis_lengths(system), State if wanted else ShapeState
    fields = {
        name: np.full((len(t), lengths[axis]) if (axis := FIELDS[name].axis) else len(t), np.nan)
        for name in state_class.__dataclass_fields__
    }
    return state_class(**(fields | {"t": t}))


def _scene_arrays(scenes: Sequence[Scene]) -> dict[str, Any]:
    """Return gravity and parameters of all members, NaN for parameters that a member lacks."""
    parameters = [
        {name: np.ravel(value) for name, value in scene.parameters.items()} for scene in scenes
    ]
    sizes = {name: len(value) for values in parameters for name, value in values.items()}
    gravity = {"gravity": np.array([scene.system.gravity for scene in scenes])}
    if not sizes:
        return gravity
    entries = [
        np.concatenate([values.get(name, np.full(size, np.nan)) for name, size in sizes.items()])
        for values in parameters
    ]
    return gravity | {
        "parameter_names": np.array(list(sizes), dtype=str),
        "parameter_sizes": np.array(list(sizes.values())),
        "parameter_values": np.array(entries),
    }


@checks_arguments
@dataclass(frozen=True, eq=False)
class RecordedMembers(RecordedStates):
    """Motions of one system, read from a file; the fields of State have shape (N, T, …).

    Attributes:
        path: Path of the file.
        robot: Name of the robot.
        group: Name of its symmetry group.
        joints: Labels of the m shape rates.
        content: States with members on the first axis; NaN at times that a member did not reach.
        failures: Members that did not reach their end time.
        impacts: The impacts at joint stops, with a column of members.
        origin: Arrays of the file that state how the robot was loaded.
    """

    path: Path
    robot: str
    group: str
    joints: tuple[str, ...]
    content: State | ShapeState
    failures: Sequence[Failure]
    impacts: MemberImpacts
    origin: Mapping[str, Any]

    def __len__(self) -> int:
        return len(self.content.x)

    def __repr__(self) -> str:
        return f"RecordedMembers({str(self.path)!r}, {len(self)} of {len(self.t)} times)"

    def __getitem__(self, member: int) -> Recording:
        """Return the motion of one member.

        Args:
            member: Index of the member.
        Returns:
            The motion.
        Raises:
            IntegrationError: The member did not reach its end time.
        """
        member = range(len(self))[member]
        for failure in self.failures:
            if failure.member == member:
                raise IntegrationError(
                    f"member {member} stopped at t = {failure.time:g} s: {failure.reason}"
                )
        content = replace(self.content, t=np.broadcast_to(self.t, self.content.energy.shape))
        states = map_arrays(lambda values: values[member], content)
        names = (self.path, self.robot, self.group, self.joints)
        impacts = self.impacts.of_member(member)
        return Recording(*names, states, self.origin, confirmed=True, impacts=impacts)

    @cached_property
    def system(self) -> System:
        """The robot, loaded at first access; its parameters are the nominal ones.

        Raises LoadError.
        """
        return load_recorded_robot(self.path, self.robot, self.group, self.origin, confirmed=False)


@checks_arguments
def read_members(path: str | Path) -> RecordedMembers:
    """Read the motions that `simulate_many(…).save` wrote to a .npz file or a .zarr folder.

    Args:
        path: Path of the file or folder.
    Returns:
        The motions.
    Raises:
        LoadError: The file cannot be read, or does not contain members.
        MissingPackageError: zarr is needed and not installed.
    """
    path = Path(path)
    content = read_zarr(path, MOST_BYTES) if path.suffix == ".zarr" else read_arrays(path)
    state_type = State if State.__dataclass_fields__.keys() <= content.keys() else ShapeState
    needed = {"robot", "group", "joints", "failure", "reached", *state_type.__dataclass_fields__}
    name = quoted_path(path)
    if missing := needed - content.keys():
        raise LoadError(f"{name} does not contain members: it has no array '{min(missing)}'")
    states = {
        field: np.asarray(content[field], dtype=float) for field in state_type.__dataclass_fields__
    }
    times, count = len(states["t"]), len(content["failure"])
    for field, values in states.items():
        if field != "t" and values.shape[:2] != (count, times):
            raise LoadError(
                f"{name}: '{field}' has shape {values.shape}, not ({count}, {times}, …)"
            )
    try:
        impacts = member_table_in(content, GROUPS[str(content["group"])].dim, count)
    except (KeyError, ValueError) as error:
        raise LoadError(f"{name}: {error}") from None
    failures = [
        Failure(k, float(content["reached"][k]), str(reason))
        for k, reason in enumerate(content["failure"].tolist())
        if reason
    ]
    origin = {key: content[key] for key in ORIGIN if key in content and key not in _OF_MEMBERS}
    return RecordedMembers(
        path, str(content["robot"]), str(content["group"]),
        tuple(map(str, np.atleast_1d(content["joints"]))), state_type(**states), failures, impacts,
        origin,
    )  # fmt: skip


# Arrays that have a row for each member.
_OF_MEMBERS = ("gravity", "parameter_names", "parameter_sizes", "parameter_values")
