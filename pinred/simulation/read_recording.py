"""Recording: a motion read from a .npz file that `Trajectory.save` wrote.

Reading executes no code: only plain arrays are taken from the file.  The robot is loaded when it
is first needed, from the source that the file states or that the user names.  The sizes of arrays
are checked before their contents are read, because a few bytes can state gigabytes.
"""

from __future__ import annotations

import json
import os
import struct
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array
from ..common.errors import InputError, LoadError, PinredError
from ..common.files import is_file
from ..common.names import plain_path, quoted, quoted_path
from ..lie.groups import GROUPS
from ..system.body_parameters import refuse_vague
from ..system.find_robot_files import bundled_robots
from ..system.load import is_path
from ..system.state_fields import FIELDS, Axis, ShapeState, State
from .impacts import ImpactTable, no_impacts, table_in
from .saved_states import OverTime, lock_in, parameters_in, save

if TYPE_CHECKING:
    from ..system.system import System

ORIGIN = (
    "source", "lock_joints", "lock_sizes", "lock_values", "gravity", "root",
    "parameter_names", "parameter_sizes", "parameter_values", "balls",
    "derivation",
)  # fmt: skip
# Largest accepted difference between q and the configuration of pose and shape [rad | m].
_TOLERANCE = 1e-6

MOST_BYTES = 1_000_000_000  # Largest accepted size of all arrays together [bytes].
_MOST_ARRAYS = 100
_READ_ERRORS = (
    ValueError, OSError, EOFError, KeyError, TypeError, NotImplementedError, SyntaxError,
    AttributeError, MemoryError, OverflowError, RuntimeError, zipfile.BadZipFile, zlib.error,
    struct.error,
)  # fmt: skip


class RecordedStates(OverTime):
    """States read from a file."""

    path: Path
    content: State | ShapeState

    @property
    def outputs(self) -> State | ShapeState:
        """The states in the file, with time as first axis after members."""
        return self.content

    @property
    def _name(self) -> str:
        return str(self.path)

    @property
    def t(self) -> Array:
        """Report times, (T,) [s]."""
        return self.content.t


@checks_arguments
@dataclass(frozen=True, eq=False)
class Recording(RecordedStates):
    """A motion read from a file: states at increasing times, and the names of robot and joints.

    Attributes:
        path: Path of the file.
        robot: Name of the robot.
        group: Name of its symmetry group, such as "SE3".
        joints: Labels of the m shape rates.
        content: State, or ShapeState if the base was left out; read-only, with time as first axis.
        origin: Arrays of the file that state how the robot was loaded.
        confirmed: Whether the user named the robot.  Otherwise only a robot known by name or a
            file in the folder of the recording is loaded.
        impacts: The impacts at joint stops.
    """

    path: Path
    robot: str
    group: str
    joints: tuple[str, ...]
    content: State | ShapeState
    origin: Mapping[str, Any]
    confirmed: bool = False
    impacts: ImpactTable = field(default_factory=lambda: no_impacts(0))

    def __repr__(self) -> str:
        end = float(self.t[-1])
        return f"Recording({str(self.path)!r}, {self.robot!r}, {len(self.t)} times to {end:g} s)"

    @cached_property
    def system(self) -> System:
        """The robot, loaded at first access.

        Raises:
            LoadError: The robot cannot be loaded.
            InputError: The robot does not match the recorded states.
        """
        system = load_recorded_robot(
            self.path, self.robot, self.group, self.origin, confirmed=self.confirmed
        )
        if system.shape_names != self.joints or system.group.name != self.group:
            raise InputError(
                f"{plain_path(self.path)} was written for group {self.group} and the joints "
                f"{', '.join(self.joints)}, but '{system.name}' has group {system.group.name} and "
                f"{', '.join(system.shape_names)}; name the right robot"
            )
        if isinstance(self.content, State):
            _require_same_robot(self.path, self.content, system)
        return system

    def save(self, path: str | Path) -> None:
        """Write the states to a .npz, .csv, .h5, .zarr or .xml file, as `Trajectory.save` does.

        Args:
            path: Path of the file; its suffix selects the format.
        """
        save(self, path)


@checks_arguments
def read_recording(path: str | Path, robot: str | None = None) -> Recording:
    """Read a motion from a .npz file that `Trajectory.save` wrote.

    Args:
        path: Path of the file.
        robot: Name or file of a robot that replaces the one stated in the file.  It is loaded at
            once, with the errors of `Recording.system`.
    Returns:
        The recorded states.
    Raises:
        LoadError: The file cannot be read, or does not contain a motion.
    """
    path = Path(path)
    content = read_arrays(path)
    missing = {"robot", "group", "joints", *ShapeState.__dataclass_fields__} - content.keys()
    if missing:
        raise LoadError(
            f"{quoted_path(path)} is not a motion that pinred wrote: it has no array "
            f"'{min(missing)}'"
        )
    origin: dict[str, Any] = {name: content[name] for name in ORIGIN if name in content}
    recording = Recording(
        path, str(content["robot"]), str(content["group"]),
        tuple(map(str, np.atleast_1d(content["joints"]))), _read_states(path, content),
        origin if robot is None else origin | {"source": str(robot)}, robot is not None,
        _read_impacts(path, content),
    )  # fmt: skip
    if robot is not None:
        _ = recording.system  # If the user named a robot, report its errors immediately.
    return recording


def _read_impacts(path: Path, content: Mapping[str, Any]) -> ImpactTable:
    """Return the impacts in a file.  Raises LoadError if they are not a table."""
    try:
        return table_in(content, GROUPS[str(content["group"])].dim)
    except ValueError as error:
        raise LoadError(f"{quoted_path(path)}: {error}") from None


def _read_states(path: Path, content: Mapping[str, Any]) -> State | ShapeState:
    """Return the states in a file.  Raises LoadError if they are not states over time."""
    if str(content["group"]) not in GROUPS:
        raise LoadError(f"{quoted_path(path)}: unknown group '{content['group']}'")
    group, m = GROUPS[str(content["group"])], np.size(content["joints"])
    nx = np.size(content.get("coordinates", content["joints"]))
    lengths: dict[Axis, int] = {
        "shape": nx, "joint": m, "twist": group.dim, "coordinate": group.size,
    }  # fmt: skip
    state_class = State if State.__dataclass_fields__.keys() <= content.keys() else ShapeState
    count, arrays = np.size(content["t"]), {}
    for name in state_class.__dataclass_fields__:
        array, axis = content[name], FIELDS[name].axis
        # q and v include follower joints, and the file does not state how many there are.
        is_full = axis in ("nq", "nv")
        width = np.shape(array)[1:] if is_full else () if axis is None else (lengths[axis],)
        shape = (count, *width)
        if array.shape != shape or (is_full and array.ndim != 2):
            raise LoadError(
                f"{quoted_path(path)}: '{name}' has shape {array.shape}, expected {shape}"
            )
        if array.dtype.kind != "f" or not np.isfinite(array).all():
            raise LoadError(
                f"{quoted_path(path)}: '{name}' has entries that are not finite numbers"
            )
        arrays[name] = np.array(array, dtype=float)
    if count == 0 or (np.diff(arrays["t"]) <= 0.0).any():
        raise LoadError(
            f"{quoted_path(path)}: 't' must contain at least one time, and be increasing"
        )
    return state_class(**arrays)


def load_recorded_robot(
    path: Path, robot: str, group: str, origin: Mapping[str, Any], *, confirmed: bool
) -> System:
    """Load the robot of a recording.

    Args:
        path: Path of the recording.
        robot: Name of the robot.
        group: Name of the symmetry group.
        origin: Arrays of the recording that state how the robot was loaded.
        confirmed: Whether the user named the source.
    Returns:
        The system with the recorded gravity, locked joints and parameters.
    Raises:
        LoadError: No source is stated, the source is not trusted, or the robot cannot be loaded.
    """
    from ..system.load import load
    from ..system.model_parameters import with_parameters

    source, text = str(origin.get("source", "")), origin.get("text")
    if "derivation" in origin and not source:
        return _derived_robot(path, str(origin["derivation"]), confirmed=confirmed)
    if not source and text is None:
        raise LoadError(
            f"{path} does not say where its robot '{robot}' comes from; name it "
            "(--robot, or robot=)"
        )
    if not confirmed and source:
        source = _find_trusted_source(path, source)
    try:
        root = str(origin["root"]) if "root" in origin else None
        parameters = parameters_in(origin)
        system = load(
            source or None, text=None if source else str(text), group=group, lock=lock_in(origin),
            gravity=origin.get("gravity"), root=root,
            balls=False if confirmed or "balls" not in origin
            else [str(name) for name in np.atleast_1d(origin["balls"])],
        )  # fmt: skip
        for name in parameters:
            refuse_vague(system, name)
        return with_parameters(system, parameters)
    except (PinredError, ValueError, TypeError) as error:
        raise LoadError(
            f"the robot of {path} cannot be loaded: {error}; name another (--robot, or robot=)"
        ) from None


def _derived_robot(path: Path, text: str, *, confirmed: bool) -> System:
    """Make a robot again from others, as a recording states.

    Args:
        path: Path of the recording.
        text: The function, its arguments and the other robots, as JSON.
        confirmed: Whether the user trusts the sources.
    Returns:
        The system.
    Raises:
        LoadError: The text is damaged, or a robot cannot be loaded.
    """
    from ..system.derived_systems import FUNCTIONS

    try:
        recipe = json.loads(text)
        make, arguments = FUNCTIONS[recipe["function"]], dict(recipe["arguments"])
        systems = [
            load_recorded_robot(
                path, str(entry["robot"]), str(entry["group"]), entry, confirmed=confirmed
            )
            for entry in recipe["systems"]
        ]
        return make(*systems, **arguments)
    except LoadError:
        raise
    except (PinredError, RecursionError, *_READ_ERRORS) as error:
        raise LoadError(
            f"{quoted_path(path)} does not state how its robot is made of others: {error}"
        ) from None


def _find_trusted_source(path: Path, source: str) -> str:
    """Return a source that may be loaded without confirmation by the user.

    A recording from somebody else could name any file on this machine.  Trusted sources are
    robots known by name, bundled files, and files in the folder of the recording, links to other
    folders excepted.

    Args:
        path: Path of the recording.
        source: Name or file of the robot that the recording states.
    Returns:
        The name, or the path of the file to load.
    Raises:
        LoadError: The source is another file.
    """
    if not is_path(source):
        return source
    try:
        # Return the resolved path, so that no link is followed after this check.
        beside = (path.parent / Path(source).name).resolve()
        if is_file(beside):
            if beside.parent == path.parent.resolve():
                return str(beside)
            raise LoadError(
                f"{quoted_path(path)} names the robot file {quoted_path(Path(source).name)}, which "
                "is a link to another folder. If you trust it, name it (--robot, or robot=)"
            )
        if Path(source).resolve() in {robot.path.resolve() for robot in bundled_robots().values()}:
            return source
    except (OSError, ValueError, RuntimeError):  # an invalid name, or a loop of links
        raise LoadError(
            f"{quoted_path(path)} names the robot file {quoted_path(source)}, which is not a valid "
            "name. Name another (--robot, or robot=)"
        ) from None
    raise LoadError(
        f"{quoted_path(path)} names the robot file {quoted_path(source)}, which is in another "
        "folder. If you trust it, name it (--robot, or robot=), or copy it to the same folder."
    )


def _require_same_robot(path: Path, states: State, system: System) -> None:
    """Raise InputError if recorded states cannot be states of a system."""
    q, shape = states.q, (len(states.t), system.model.nq)
    if q.shape != shape:
        raise InputError(f"{path}: 'q' has shape {q.shape}, but '{system.name}' has {shape}")
    if states.v.shape[1] != system.model.nv:
        raise InputError(
            f"{path}: 'v' has shape {states.v.shape}, but '{system.name}' has {system.model.nv} "
            "velocities"
        )
    expected = system.q(system.configuration(q).pose, states.x)
    normalised = all(pin.isNormalized(system.model, q_t, _TOLERANCE) for q_t in q)
    if not normalised or np.abs(expected - q).max() > _TOLERANCE:
        raise InputError(f"{path}: 'q' is not the configuration of '{system.name}' at shape 'x'")


def read_arrays(path: Path) -> dict[str, Any]:
    """Return the arrays of a .npz file by name.

    Args:
        path: Path of the file.
    Returns:
        The arrays; Python objects are never read.
    Raises:
        LoadError: The file is missing, unreadable, too large, or contains other data.
    """
    name = quoted_path(path)
    if not is_file(path):
        raise LoadError(f"no such file: {plain_path(path)}")
    if not os.access(path, os.R_OK):
        raise LoadError(f"{name} cannot be read: permission denied")
    if path.stat().st_size > MOST_BYTES:
        raise LoadError(f"{name} is larger than {MOST_BYTES // 10**6} MB")
    if not zipfile.is_zipfile(path):
        raise LoadError(
            f"{name} is not an .npz file of plain arrays: it is not a zip archive, or truncated"
        )
    try:
        with zipfile.ZipFile(path) as archive:
            _check_sizes(name, archive)
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            return {key: file[key] for key in file.files}
    except _READ_ERRORS:  # NumPy's messages advise options that users of pinred do not have.
        raise LoadError(
            f"{name} is not an .npz file of plain arrays: its contents are damaged, "
            "or made of Python objects, which are not read"
        ) from None


def _check_sizes(name: str, archive: zipfile.ZipFile) -> None:
    """Check the stated sizes of an archive.

    Args:
        name: Name of the file, for messages.
        archive: The open archive.
    Raises:
        LoadError: The archive is too large, or contains entries that are not arrays.
        ValueError: The header of an array does not match its size.
    """
    members = archive.infolist()
    if len(members) > _MOST_ARRAYS:
        raise LoadError(f"{name} has {len(members)} arrays, more than {_MOST_ARRAYS}")
    for member in members:
        if not member.filename.endswith(".npy"):
            raise LoadError(
                f"{name} is not an .npz file of plain arrays: {quoted(member.filename)} is not an "
                "array"
            )
    total = sum(member.file_size for member in members)
    if total > MOST_BYTES:
        raise LoadError(
            f"{name} would take {total / 1e9:.3g} GB unpacked, more than {MOST_BYTES / 1e9:g}; "
            "record fewer times"
        )
    for member in members:
        with archive.open(member) as stream:
            version = np.lib.format.read_magic(stream)
            read_header = {
                (1, 0): np.lib.format.read_array_header_1_0,
                (2, 0): np.lib.format.read_array_header_2_0,
            }[version]
            shape, _, dtype = read_header(stream)
            size = dtype.itemsize
            for length in shape:
                size *= length
            if (
                dtype.hasobject
                or min(shape, default=0) < 0
                or stream.tell() + size != (member.file_size)
            ):
                raise ValueError
