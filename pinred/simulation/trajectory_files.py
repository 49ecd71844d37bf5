"""Files of trajectories in common formats: .npz, .csv, .zarr, and keyframes of MuJoCo (.xml)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO

import numpy as np

from ..common.errors import OutputError
from ..common.files import check_path, write_atomic
from ..common.names import quoted_path
from ..common.optional_packages import optional_package
from ..system.locked_joints import LockValue
from ..system.model_parameters import GRAVITY
from ..system.state_fields import FIELDS, arrays_of, axis_labels
from ..system.system import System
from .over_time import OverTime

_GREEK = str.maketrans({"θ": "theta"})


def save(traj: OverTime, path: str | Path) -> None:
    """Write the states of a motion at its report times; no partial file remains after a failure.

    .npz contains one array for each field of State, with time as first axis, and `robot`, `group`
    and `joints`.  The arrays `source`, `lock_joints`, `lock_sizes`, `lock_values`, `gravity`,
    `root` and `parameter_names`, `parameter_sizes`, `parameter_values` state how load() finds the
    robot.
    .csv has a row for each time and columns such as `pose.x`, `x.hinge` and `energy`.
    .zarr is a folder with the arrays of .npz, and texts as its attributes.
    .xml has a keyframe of MuJoCo for each time; the robot must be from an MJCF file.

    InputError is raised for another suffix or a folder that does not exist, OutputError if
    writing fails, and MissingPackageError if zarr is not installed.

    Args:
        traj: A Trajectory or a Recording.
        path: Path of the file; its suffix selects the format.
    """
    path = check_path(path, (".npz", ".csv", ".zarr", ".xml"))
    if path.suffix == ".zarr":
        write_zarr(path, _arrays(traj))
        return
    write = {".npz": _write_npz, ".csv": _write_csv, ".xml": _write_keyframes}[path.suffix]
    write_atomic(path, lambda file: write(traj, file))


def _write_npz(traj: OverTime, file: BinaryIO) -> None:
    np.savez_compressed(file, **_arrays(traj))


def _write_keyframes(traj: OverTime, file: BinaryIO) -> None:
    from ..system.mjcf.keyframe_export import write_keyframes

    out = traj.states
    rows = zip(out.t.tolist(), out.pose, out.x, out.xi, out.xdot, strict=True)
    file.write(write_keyframes(traj.system, rows).encode())


def _arrays(traj: OverTime) -> dict[str, Any]:
    return {**robot_arrays(traj.system), **arrays_of(traj.outputs)}


def robot_arrays(system: System) -> dict[str, Any]:
    """Return the arrays that name a robot and record how load() finds it.

    Gravity and locked joints are stored with their current values, including changes by parameters.
    """
    origin = system.origin
    lock = dict({} if origin is None else origin.lock)
    parameters = dict(system.parameters)
    for name in system.parameters:
        if name.endswith(".lock"):
            lock[name.removesuffix(".lock")] = float(parameters.pop(name))
        elif name in GRAVITY:
            del parameters[name]
    root = {} if origin is None or origin.root is None else {"root": np.array(origin.root)}
    return {
        "robot": np.array(system.name),
        "group": np.array(system.group.name),
        "joints": np.array(system.shape_names, dtype=str),
        **({"coordinates": np.array(system.x_names, dtype=str)} if system.space.balls else {}),
        "source": np.array("" if origin is None else origin.source),
        **_lock_arrays(lock),
        "gravity": system.gravity,
        **root,
        **_parameter_arrays(parameters),
    }


def _lock_arrays(lock: Mapping[str, LockValue]) -> dict[str, Any]:
    """Return the names and values of locked joints, and the sizes unless all are 1."""
    entries = [np.atleast_1d(value) for value in lock.values()]
    sizes = np.array([len(array) for array in entries], dtype=int)
    return {
        "lock_joints": np.array(list(lock), dtype=str),
        "lock_values": np.concatenate([np.empty(0), *entries]),
        **({"lock_sizes": sizes} if (sizes > 1).any() else {}),
    }


def lock_in(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return the locked joints in the arrays of a file, {joint: number or list of numbers}.

    Args:
        content: Arrays of a file by name.  Without sizes, each joint has one number.
    Returns:
        The values of the locked joints.
    Raises:
        ValueError: The lengths of the names, sizes and values do not match.
    """
    names = np.atleast_1d(content.get("lock_joints", ()))
    sizes = content.get("lock_sizes", np.ones(len(names), dtype=int))
    arrays = _split("locked joints", names, sizes, content.get("lock_values", ()))
    return {
        name: float(values[0]) if len(values) == 1 else values.tolist()
        for name, values in arrays.items()
    }


def _split(what: str, names: Any, sizes: Any, values: Any) -> dict[str, Any]:
    """Split values, (sum of sizes,), into an array for each name.  Raises ValueError."""
    names = [str(name) for name in np.atleast_1d(names)]
    sizes = [int(size) for size in np.atleast_1d(sizes)]
    values = np.ravel(np.asarray(values, dtype=float))
    if len(names) != len(sizes) or min(sizes, default=1) < 1 or sum(sizes) != len(values):
        raise ValueError(f"the names, sizes and values of its {what} are inconsistent")
    arrays = np.split(values, np.cumsum(sizes)[:-1]) if names else []
    return dict(zip(names, arrays, strict=True))


def _parameter_arrays(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the names of parameters, the number of entries of each, and all entries."""
    if not values:
        return {}
    entries = [np.ravel(value) for value in values.values()]
    return {
        "parameter_names": np.array(list(values), dtype=str),
        "parameter_sizes": np.array([len(array) for array in entries]),
        "parameter_values": np.concatenate(entries).astype(float),
    }


def parameters_in(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return the robot parameters in the arrays of a file, {name: values}.

    Args:
        content: Arrays of a file by name.
    Returns:
        The values of each parameter, (size,).
    Raises:
        ValueError: The lengths of the names, sizes and values do not match.
    """
    names, sizes, values = (
        content.get(f"parameter_{what}", ()) for what in ("names", "sizes", "values")
    )
    return _split("parameters", names, sizes, values)


def _write_csv(traj: OverTime, file: BinaryIO) -> None:
    labels, r = axis_labels(traj.system), traj.system.r
    labels["coordinate"] = [name.translate(_GREEK) for name in labels["coordinate"]]
    labels["twist"] = ["s"] if r == 1 else range(1, r + 1)
    names, columns = [], []
    for name, values in arrays_of(traj.outputs).items():
        axis = FIELDS[name].axis
        names += [name] if axis is None else [f"{name}.{label}" for label in labels[axis]]
        columns.append(values)
    header = ",".join(map(_quote_for_csv, names))
    table = np.column_stack(columns)
    np.savetxt(file, table, fmt="%.17g", delimiter=",", header=header, comments="")


def _quote_for_csv(name: str) -> str:
    """Return a column name, in quotes if it contains a separator, quote or line break."""
    if not any(mark in name for mark in ',"\r\n'):
        return name
    return '"' + name.replace('"', '""') + '"'


def write_zarr(path: Path, arrays: dict[str, Any]) -> None:
    """Write arrays to a zarr folder, which gets its final name only when it is complete.

    Args:
        path: Path of the folder, which must not exist.
        arrays: Arrays by name; texts become attributes of the folder.
    Raises:
        MissingPackageError: zarr is not installed.
        OutputError: Writing fails.
    """
    zarr = optional_package(
        "zarr",
        f"{quoted_path(path)}: files of zarr need the package zarr: pip install 'pinred[zarr]'",
    )
    try:
        with TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as parent:
            folder = Path(parent) / "complete"
            root = zarr.open_group(str(folder), mode="w")
            for name, array in arrays.items():
                if array.ndim and array.dtype.kind == "f":
                    root.create_array(name, data=array)
                else:  # Store texts, and sizes of parameters, as attributes.
                    root.attrs[name] = array.tolist()
            folder.rename(path)
    except OSError as error:
        raise OutputError(f"cannot write {quoted_path(path)}: {error.strerror or error}") from error
