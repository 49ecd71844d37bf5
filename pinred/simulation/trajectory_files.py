"""Trajectories as files that other tools open: NumPy's npz, csv, and zarr."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ..common.files import check_path, write_atomic
from ..system.system import System
from .state import OverTime
from .zarr_files import write_zarr

_GREEK = str.maketrans({"θ": "theta"})


def save(traj: OverTime, path: str | Path) -> None:
    """Write the states of `traj` at its report times; the suffix, .npz, .csv or .zarr, decides.

    npz: one array per field of State, time first, with `robot`, `group` and `joints`, and
    what load() needs to find the robot again: `source`, `lock_joints`, `lock_values`, `gravity`,
    and `root` if it was given.
    csv: a row per time, columns such as `pose.x`, `x.hinge`, `energy`.
    zarr: a folder with the arrays of npz, text as its attributes; needs the package zarr.
    Either the whole file is written or none.  Raises InputError for another suffix or a
    folder that does not exist, OutputError if writing fails, MissingPackageError.
    """
    path = check_path(path, (".npz", ".csv", ".zarr"))
    if path.suffix == ".zarr":
        write_zarr(path, _arrays(traj))
        return
    write = _write_npz if path.suffix == ".npz" else _write_csv
    write_atomic(path, lambda file: write(traj, file))


def _write_npz(traj: OverTime, file: BinaryIO) -> None:
    np.savez_compressed(file, **_arrays(traj))


def _arrays(traj: OverTime) -> dict[str, Any]:
    arrays = {field.name: getattr(traj.outputs, field.name) for field in fields(traj.outputs)}
    return {**about_robot(traj.system), **arrays}


def about_robot(system: System) -> dict[str, Any]:
    """Return arrays that say which robot a file is of, and where load() finds it."""
    origin = system.origin
    lock = {} if origin is None else origin.lock
    chosen = {} if origin is None or origin.root is None else {"root": np.array(origin.root)}
    return {
        "robot": np.array(system.name),
        "group": np.array(system.group.name),
        "joints": np.array(system.shape_names, dtype=str),
        "source": np.array("" if origin is None else origin.source),
        "lock_joints": np.array(list(lock), dtype=str),
        "lock_values": np.array(list(lock.values()), dtype=float),
        "gravity": system.gravity,
        **chosen,
    }


def _write_csv(traj: OverTime, file: BinaryIO) -> None:
    system = traj.system
    twist = ("s",) if system.r == 1 else tuple(str(k + 1) for k in range(system.r))
    labels = {
        "x": system.shape_names,
        "xdot": system.shape_names,
        "pose": [name.translate(_GREEK) for name in system.group.pose_names],
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
