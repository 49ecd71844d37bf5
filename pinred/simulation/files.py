"""Trajectories as files that other tools open: NumPy's npz, and csv."""

from __future__ import annotations

import csv
import io
import os
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..common.errors import InputError, OutputError
from ..lie.groups import SE2, SE3, SO2, SO3
from .trajectory import Trajectory

_POSE_LABELS = {
    "R": ("s",),
    SO2.name: ("theta",),
    SE2.name: ("x", "y", "theta"),
    SO3.name: ("qx", "qy", "qz", "qw"),
    SE3.name: ("x", "y", "z", "qx", "qy", "qz", "qw"),
}


def save(traj: Trajectory, path: str | Path) -> None:
    """Write the states of `traj` at its report times; the suffix, .npz or .csv, decides.

    npz: one array per field of State, time first, with `robot`, `group` and `joints`, and
    what load() needs to find the robot again: `source`, `lock_joints`, `lock_values`, `gravity`.
    csv: a row per time, columns such as `pose.x`, `x.hinge`, `energy`.
    Either the whole file is written or none.  Raises InputError for another suffix or a
    folder that does not exist, OutputError if writing fails.
    """
    path = check_path(path)
    write = _write_npz if path.suffix == ".npz" else _write_csv
    write_atomic(path, lambda file: write(traj, file))


def check_path(path: str | Path, suffixes: Sequence[str] = (".npz", ".csv")) -> Path:
    """Return `path` if a file can be written there.  Raises InputError or OutputError if not."""
    if not isinstance(path, (str, os.PathLike)) or "\0" in str(path):
        raise InputError(f"path must be the name of a file, got {path!r}")
    path = Path(path)
    if path.suffix not in suffixes:
        raise InputError(f"cannot write '{path}': the suffix must be {' or '.join(suffixes)}")
    try:
        if path.is_dir():
            raise InputError(f"cannot write '{path}': it is a folder")
        if not path.parent.is_dir():
            raise InputError(f"cannot write '{path}': there is no folder '{path.parent}'")
        # Try now what the end of a long simulation will need.
        with tempfile.NamedTemporaryFile(dir=path.parent, prefix=f".{path.name}."):
            return path
    except OSError as error:
        raise OutputError(f"cannot write '{path}': {error.strerror or error}") from None


def write_atomic(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Write a file under a temporary name beside `path` and move it there when complete.

    Raises OutputError if that fails.
    """
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "wb") as file:
                write(file)
            umask = os.umask(0)  # mkstemp makes the file private; give it the usual rights
            os.umask(umask)
            os.chmod(name, 0o666 & ~umask)
            os.replace(name, path)
        except BaseException:
            os.unlink(name)
            raise
    except OSError as error:
        raise OutputError(f"cannot write '{path}': {error.strerror or error}") from error


def write_table(path: Path, columns: Sequence[str], rows: Iterable[Mapping[str, object]]) -> None:
    """Write rows by their columns as csv, whole or not at all.  Raises OutputError."""
    text = io.StringIO()
    table = csv.DictWriter(text, columns, lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    write_atomic(path, lambda file: file.write(text.getvalue().encode()))


def _write_npz(traj: Trajectory, file: BinaryIO) -> None:
    arrays = {field.name: getattr(traj.outputs, field.name) for field in fields(traj.outputs)}
    system = traj.system
    lock = {} if system.origin is None else system.origin.lock
    np.savez_compressed(
        file,
        robot=np.array(system.name),
        group=np.array(system.group.name),
        joints=np.array(system.shape_names, dtype=str),
        source=np.array("" if system.origin is None else system.origin.source),
        lock_joints=np.array(list(lock), dtype=str),
        lock_values=np.array(list(lock.values()), dtype=float),
        gravity=system.gravity,
        **arrays,
    )


def _write_csv(traj: Trajectory, file: BinaryIO) -> None:
    system = traj.system
    twist = _POSE_LABELS["R"] if system.r == 1 else tuple(str(k + 1) for k in range(system.r))
    labels = {
        "x": system.shape_names,
        "xdot": system.shape_names,
        "pose": _POSE_LABELS[system.group.name],
        "xi": twist,
        "body_momentum": twist,
        "spatial_momentum": twist,
    }
    names, columns = [], []
    for field in fields(traj.outputs):
        values = getattr(traj.outputs, field.name)
        if values.ndim == 1:
            names.append(field.name)
            columns.append(values)
            continue
        for k in range(values.shape[1]):
            label = labels[field.name][k] if field.name in labels else str(k)
            names.append(f"{field.name}.{label}")
            columns.append(values[:, k])
    table = np.column_stack(columns)
    header = ",".join(map(_quoted, names))
    np.savetxt(file, table, fmt="%.17g", delimiter=",", header=header, comments="")


def _quoted(name: str) -> str:
    """Return a column's name as csv has it: in quotes if it would not be one field."""
    if not any(mark in name for mark in ',"\r\n'):
        return name
    return '"' + name.replace('"', '""') + '"'
