"""Recording: the states of a motion, from a trajectory or from the .npz file that it wrote.

Reading executes nothing: only plain arrays are taken from the file.
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import Array, freeze
from ..errors import InputError, LoadError, PinredError
from ..loading import load
from ..system import System
from ..trajectory import Trajectory

_ARRAYS = ("t", "x", "xdot", "q", "v")
_AGREE = 1e-6  # rad | m; how far q may be from pose and shape


@dataclass(frozen=True)
class Recording:
    """States at times t (T,) [s], increasing: x, xdot (T, m), Pinocchio's q (T, nq), v (T, n)."""

    system: System
    t: Array
    x: Array
    xdot: Array
    q: Array
    v: Array

    def __post_init__(self) -> None:
        freeze(self)


def recorded(traj: Trajectory, times: Array) -> Recording:
    """Return the states of a trajectory at times.  Raises InputError without the base."""
    states = traj(times)
    return Recording(traj.system, *(np.array(getattr(states, name)) for name in _ARRAYS))


def read_recording(path: str | Path, robot: str | None = None) -> Recording:
    """Return the motion in a .npz file that `Trajectory.save` has written.

    robot: a name or a file to take instead of what the file says.
    Raises LoadError if the file or its robot cannot be read, InputError if they do not
    belong together.
    """
    path = Path(path)
    entries = _read(path)
    for name in ("robot", "group", "joints", *_ARRAYS[:3]):
        if name not in entries:
            raise LoadError(f"{path} is no trajectory: it has no array '{name}'")
    if "q" not in entries or "v" not in entries:
        raise InputError(
            f"{path} leaves out the base (outputs='shape'); simulate with outputs='all' to play it"
        )
    system = _system(path, entries, robot)
    joints = tuple(map(str, entries["joints"].ravel()))
    if system.shape_names != joints or system.group.name != str(entries["group"]):
        raise InputError(
            f"{path} was written for group {entries['group']} and the joints "
            f"{', '.join(joints)}, but '{system.name}' has group {system.group.name} and "
            f"{', '.join(system.shape_names)}; name the right robot"
        )
    found = _checked(path, entries, system)
    return Recording(system, *found)


def _read(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise LoadError(f"no such file: {path}")
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except (ValueError, OSError, EOFError, KeyError, zipfile.BadZipFile, AttributeError) as error:
        raise LoadError(f"{path} is no .npz file of plain arrays: {error}") from None


def _system(path: Path, entries: dict[str, Any], robot: str | None) -> System:
    """Return the system that the file names, or the one given."""
    source = robot or str(entries.get("source", ""))
    if not source:
        raise InputError(
            f"{path} does not say where its robot '{entries['robot']}' comes from; name it "
            "(--robot, or robot=)"
        )
    beside = path.parent / Path(source).name
    if Path(source).is_absolute() and not Path(source).is_file() and beside.is_file():
        source = str(beside)
    try:
        names = map(str, entries["lock_joints"]) if "lock_joints" in entries else ()
        values = map(float, entries["lock_values"]) if "lock_values" in entries else ()
        lock = dict(zip(names, values, strict=True))
        gravity = entries.get("gravity")
        return load(source, group=str(entries["group"]), lock=lock, gravity=gravity)
    except (PinredError, ValueError, TypeError) as error:
        raise LoadError(
            f"the robot of {path} cannot be loaded: {error}; name another (--robot, or robot=)"
        ) from None


def _checked(path: Path, entries: dict[str, Any], system: System) -> list[Array]:
    """Return t, x, xdot, q, v.  Raises InputError if they are not states of this system."""
    sizes = (None, system.m, system.m, system.model.nq, system.n)
    count = np.size(entries["t"])
    found = []
    for name, size in zip(_ARRAYS, sizes, strict=True):
        array = entries[name]
        shape = (count,) if size is None else (count, size)
        if array.dtype.kind != "f" or array.shape != shape or not np.isfinite(array).all():
            raise InputError(f"{path}: '{name}' must be finite numbers of shape {shape}")
        found.append(np.array(array, dtype=float))
    t, x, q = found[0], found[1], found[3]
    if count < 2 or (np.diff(t) <= 0.0).any():
        raise InputError(f"{path}: 't' must hold two increasing times at least")
    wanted = system.q(system.configuration(q).pose, x)
    if np.abs(wanted - q).max() > _AGREE:
        raise InputError(f"{path}: 'q' is not the configuration of '{system.name}' at shape 'x'")
    return found
