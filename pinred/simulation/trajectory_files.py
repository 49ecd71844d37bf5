"""Trajectories as files that other tools open: NumPy's npz, csv, and zarr."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ..common.files import check_path, write_atomic
from ..system.model_parameters import GRAVITY
from ..system.state_fields import FIELDS, arrays_of, axis_labels
from ..system.system import System
from .over_time import OverTime
from .zarr_files import write_zarr

_GREEK = str.maketrans({"θ": "theta"})


def save(traj: OverTime, path: str | Path) -> None:
    """Write the states of `traj` at its report times; the suffix, .npz, .csv or .zarr, decides.

    npz: one array per field of State, time first, with `robot`, `group` and `joints`, and
    what load() needs to find the robot again: `source`, `lock_joints`, `lock_values`, `gravity`,
    `root` if it was given, and other numbers of the robot as `parameter_names`, `parameter_sizes`
    and `parameter_values`, one after another.
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
    return {**about_robot(traj.system), **arrays_of(traj.outputs)}


def about_robot(system: System) -> dict[str, Any]:
    """Return arrays that say which robot a file is of, and where load() finds it.

    Gravity and locked joints are as they are, whoever gave them: the loaded robot or parameters.
    """
    origin = system.origin
    lock = dict({} if origin is None else origin.lock)
    others = dict(system.parameters)
    for name in system.parameters:
        if name.endswith(".lock"):
            lock[name.removesuffix(".lock")] = float(others.pop(name))
        elif name in GRAVITY:
            del others[name]
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
        **_parameters(others),
    }


def _parameters(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return arrays with the names of parameters, how many numbers each has, and all of these."""
    if not values:
        return {}
    rows = [np.ravel(value) for value in values.values()]
    return {
        "parameter_names": np.array(list(values), dtype=str),
        "parameter_sizes": np.array([len(row) for row in rows]),
        "parameter_values": np.concatenate(rows).astype(float),
    }


def parameters_in(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parameters, {name: value}, in arrays that were read.

    Raises ValueError if these do not belong together.
    """
    names = [str(name) for name in np.atleast_1d(content.get("parameter_names", ()))]
    sizes = [int(size) for size in np.atleast_1d(content.get("parameter_sizes", ()))]
    values = np.ravel(np.asarray(content.get("parameter_values", ()), dtype=float))
    if len(names) != len(sizes) or min(sizes, default=1) < 1 or sum(sizes) != len(values):
        raise ValueError("the names, sizes and values of its parameters do not belong together")
    rows = np.split(values, np.cumsum(sizes)[:-1]) if names else []
    return dict(zip(names, rows, strict=True))


def _write_csv(traj: OverTime, file: BinaryIO) -> None:
    labels = axis_labels(traj.system)
    labels["coordinate"] = [name.translate(_GREEK) for name in labels["coordinate"]]
    r = traj.system.r
    labels["twist"] = ["s"] if r == 1 else range(1, r + 1)
    names, columns = [], []
    for name, values in arrays_of(traj.outputs).items():
        axis = FIELDS[name].axis
        names += [name] if axis is None else [f"{name}.{label}" for label in labels[axis]]
        columns.append(values)
    table = np.column_stack(columns)
    header = ",".join(map(_quoted, names))
    np.savetxt(file, table, fmt="%.17g", delimiter=",", header=header, comments="")


def _quoted(name: str) -> str:
    """Return a column's name as csv has it: in quotes if it would not be one field."""
    if not any(mark in name for mark in ',"\r\n'):
        return name
    return '"' + name.replace('"', '""') + '"'
