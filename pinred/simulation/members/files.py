"""Members of simulate_many as files: NumPy's npz, and zarr where it is installed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from ...common.errors import MissingPackageError, OutputError
from ...common.files import check_path, write_atomic
from ...common.plain_names import quoted_path
from ..state import OverTime
from ..trajectory_files import about_robot


def save(members: OverTime, failures: Mapping[int, tuple[float, str]], path: str | Path) -> None:
    """Write the states of all members; the suffix, .npz or .zarr, decides.

    failures: of members that did not come to their end, the time reached and the reason.
    One array per field of State, (N, T, …), `t`, (T,), and of the members `failure`, (N,), why one
    stopped, "" for none, and `reached`, (N,) [s]; and what `Trajectory.save` writes of the robot.
    zarr: a folder with these arrays, text as its attributes; needs the package zarr.
    Either the whole file is written or none.  Raises InputError for another suffix or a folder that
    does not exist, OutputError if writing fails, MissingPackageError.
    """
    path = check_path(path, (".npz", ".zarr"))
    arrays = _arrays(members, failures)
    if path.suffix == ".npz":
        write_atomic(path, lambda file: np.savez_compressed(file, **arrays))
    else:
        _write_zarr(path, arrays)


def _arrays(members: OverTime, failures: Mapping[int, tuple[float, str]]) -> dict[str, Any]:
    outputs = members.outputs
    arrays = {field.name: getattr(outputs, field.name) for field in fields(outputs)}
    count, end = len(outputs.x), float(outputs.t[-1])
    reasons, reached = [""] * count, np.full(count, end)
    for member, (time, reason) in failures.items():
        reasons[member], reached[member] = reason, time
    return {
        **about_robot(members.system),
        **arrays,
        "failure": np.array(reasons, dtype=str),
        "reached": reached,
    }


def _write_zarr(path: Path, arrays: dict[str, Any]) -> None:
    """Write a folder of arrays, under another name until it is whole."""
    try:
        zarr = import_module("zarr")
    except ImportError:
        raise MissingPackageError(
            f"{quoted_path(path)}: files of zarr need the package zarr: pip install 'pinred[zarr]'"
        ) from None
    try:
        with TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
            whole = Path(folder) / "whole"
            root = zarr.open_group(str(whole), mode="w")
            for name, array in arrays.items():
                if array.ndim and array.dtype.kind == "f":
                    root.create_array(name, data=array)
                else:  # text and what it is of
                    root.attrs[name] = array.tolist()
            whole.rename(path)
    except OSError as error:
        raise OutputError(f"cannot write {quoted_path(path)}: {error.strerror or error}") from error
