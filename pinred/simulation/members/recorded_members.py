"""RecordedMembers: the motions that `Trajectories.save` wrote, read from a file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array
from ...common.errors import IntegrationError, LoadError
from ...common.names import quoted_path
from ...lie.groups import GROUPS
from ...system.state_fields import ShapeState, State, map_arrays
from ..impacts import MemberImpacts, member_table_in
from ..over_time import OverTime, read_zarr
from ..recording import MOST_BYTES, ORIGIN, Recording, load_recorded_robot, read_arrays
from .trajectories import Failure

if TYPE_CHECKING:
    from ...system.system import System


@checks_arguments
@dataclass(frozen=True, eq=False)
class RecordedMembers(OverTime):
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

    @property
    def outputs(self) -> State | ShapeState:
        """The states in the file, with members on the first axis."""
        return self.content

    @property
    def _name(self) -> str:
        return str(self.path)

    @property
    def t(self) -> Array:
        """Report times, (T,) [s]."""
        return self.content.t

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
    kind = State if State.__dataclass_fields__.keys() <= content.keys() else ShapeState
    needed = {"robot", "group", "joints", "failure", "reached", *kind.__dataclass_fields__}
    name = quoted_path(path)
    if missing := needed - content.keys():
        raise LoadError(f"{name} does not contain members: it has no array '{min(missing)}'")
    states = {field: np.asarray(content[field], dtype=float) for field in kind.__dataclass_fields__}
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
        tuple(map(str, np.atleast_1d(content["joints"]))), kind(**states), failures, impacts,
        origin,
    )  # fmt: skip


# Arrays that have a row for each member.
_OF_MEMBERS = ("gravity", "parameter_names", "parameter_sizes", "parameter_values")
