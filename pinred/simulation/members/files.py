"""Members of simulate_many as files: NumPy's npz, and zarr where it is installed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from ...common.files import check_path, write_atomic
from ..state import OverTime
from ..trajectory_files import about_robot
from ..zarr_files import write_zarr


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
        write_zarr(path, arrays)


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
