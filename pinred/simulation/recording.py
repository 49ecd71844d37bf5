"""Recording: a motion read back from the .npz file that `Trajectory.save` wrote.

Reading executes nothing: only plain arrays are taken from the file.  The robot is loaded when
something needs it, from where the file says, or from where one says.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..common.errors import InputError, LoadError, PinredError
from ..common.paths import is_file
from ..common.plain_names import plain_path, quoted_path
from ..lie.groups import GROUPS
from ..system.catalogue import bundled_robots
from ..system.load import is_path
from ..system.state_fields import FIELDS, Axis, ShapeState, State
from .archive import read_arrays
from .over_time import OverTime
from .trajectory_files import parameters_in, save

if TYPE_CHECKING:
    from ..system.system import System

_ORIGIN = (
    "source", "lock_joints", "lock_values", "gravity", "root",
    "parameter_names", "parameter_sizes", "parameter_values",
)  # fmt: skip
_AGREE = 1e-6  # rad | m; how far q may be from pose and shape


@dataclass(frozen=True, eq=False)
class Recording(OverTime):
    """States at the times of a file, increasing, and the names of robot, group and joints.

    content: a State, or a ShapeState where the base was left out; time first, read-only.
    origin: what the file says about where its robot comes from.  confirmed: whether it is not the
    file that says so, but the user: else only a robot known by name, or one in the same folder,
    is loaded.
    """

    path: Path
    robot: str
    group: str
    joints: tuple[str, ...]
    content: State | ShapeState
    origin: Mapping[str, Any]
    confirmed: bool = False

    def __repr__(self) -> str:
        end = float(self.t[-1])
        return f"Recording({str(self.path)!r}, {self.robot!r}, {len(self.t)} times to {end:g} s)"

    @property
    def outputs(self) -> State | ShapeState:
        """Contents of the file, time first."""
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
        """The robot, loaded when first looked at.

        Raises LoadError if it cannot be loaded, InputError if it and the file do not belong
        together.
        """
        system = _loaded(self.path, self.robot, self.group, self.origin, confirmed=self.confirmed)
        if system.shape_names != self.joints or system.group.name != self.group:
            raise InputError(
                f"{plain_path(self.path)} was written for group {self.group} and the joints "
                f"{', '.join(self.joints)}, but '{system.name}' has group {system.group.name} and "
                f"{', '.join(system.shape_names)}; name the right robot"
            )
        if isinstance(self.content, State):
            _belong(self.path, self.content, system)
        return system

    def save(self, path: str | Path) -> None:
        """Write the states to a .npz, .csv or .zarr file, as `Trajectory.save` does."""
        save(self, path)


def read_recording(path: str | Path, robot: str | None = None) -> Recording:
    """Return the motion in a .npz file that `Trajectory.save` wrote.

    robot: a name or a file to take instead of what the file says; it is loaded at once.
    Raises LoadError if the file cannot be read or holds something else, and for the robot as
    `Recording.system`.
    """
    path = Path(path)
    content = read_arrays(path)
    missing = {"robot", "group", "joints", *ShapeState.__dataclass_fields__} - content.keys()
    if missing:
        raise LoadError(
            f"{quoted_path(path)} is not a motion that pinred wrote: it has no array "
            f"'{min(missing)}'"
        )
    origin: dict[str, Any] = {name: content[name] for name in _ORIGIN if name in content}
    found = Recording(
        path, str(content["robot"]), str(content["group"]),
        tuple(map(str, np.atleast_1d(content["joints"]))), _outputs(path, content),
        origin if robot is None else origin | {"source": str(robot)}, robot is not None,
    )  # fmt: skip
    if robot is not None:
        _ = found.system  # what was asked for by name is not refused only later
    return found


def _outputs(path: Path, content: Mapping[str, Any]) -> State | ShapeState:
    """Return the states in a file.  Raises LoadError if they are not states over time."""
    if str(content["group"]) not in GROUPS:
        raise LoadError(f"{quoted_path(path)}: unknown group '{content['group']}'")
    group, m = GROUPS[str(content["group"])], np.size(content["joints"])
    lengths: dict[Axis, int] = {"joint": m, "twist": group.dim, "coordinate": group.size}
    kind = State if State.__dataclass_fields__.keys() <= content.keys() else ShapeState
    count, arrays = np.size(content["t"]), {}
    for name in kind.__dataclass_fields__:
        array, axis = content[name], FIELDS[name].axis
        # The file does not say how many of Pinocchio's joints follow others.
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
        raise LoadError(f"{quoted_path(path)}: 't' must hold increasing times")
    return kind(**arrays)


def _loaded(
    path: Path, robot: str, group: str, origin: Mapping[str, Any], *, confirmed: bool
) -> System:
    """Return the system that a file names.  confirmed: by the user.  Raises LoadError."""
    from ..system.load import load

    source = str(origin.get("source", ""))
    if not source:
        raise LoadError(
            f"{path} does not say where its robot '{robot}' comes from; name it "
            "(--robot, or robot=)"
        )
    if not confirmed:
        source = _not_elsewhere(path, source)
    try:
        names = map(str, origin.get("lock_joints", ()))
        values = map(float, origin.get("lock_values", ()))
        lock = dict(zip(names, values, strict=True))
        root = str(origin["root"]) if "root" in origin else None
        return load(
            source, group=group, lock=lock, gravity=origin.get("gravity"), root=root,
            parameters=parameters_in(origin),
        )  # fmt: skip
    except (PinredError, ValueError, TypeError) as error:
        raise LoadError(
            f"the robot of {path} cannot be loaded: {error}; name another (--robot, or robot=)"
        ) from None


def _not_elsewhere(path: Path, source: str) -> str:
    """Return the name of a robot that a file may have loaded unasked: a known one, or one beside.

    A file from somebody else could name anything on this machine.  Raises LoadError.
    """
    if not is_path(source):
        return source
    beside = path.parent / Path(source).name
    if is_file(beside):
        return str(beside)
    if Path(source).resolve() in {robot.path.resolve() for robot in bundled_robots().values()}:
        return source
    raise LoadError(
        f"{quoted_path(path)} says that its robot is in {quoted_path(source)}, which is not in "
        "its own folder; if that is so, name it (--robot, or robot=), or copy it there"
    )


def _belong(path: Path, states: State, system: System) -> None:
    """Raise InputError if the states are not those of a system."""
    q, shape = states.q, (len(states.t), system.model.nq)
    if q.shape != shape:
        raise InputError(f"{path}: 'q' has shape {q.shape}, but '{system.name}' has {shape}")
    if states.v.shape[1] != system.model.nv:
        raise InputError(
            f"{path}: 'v' has shape {states.v.shape}, but '{system.name}' has {system.model.nv} "
            "velocities"
        )
    wanted = system.q(system.configuration(q).pose, states.x)
    rotations = all(pin.isNormalized(system.model, row, _AGREE) for row in system.sorted_q(q))
    if not rotations or np.abs(wanted - q).max() > _AGREE:
        raise InputError(f"{path}: 'q' is not the configuration of '{system.name}' at shape 'x'")
