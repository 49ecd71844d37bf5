"""Members of simulate_many as files: NumPy's npz, and zarr where it is installed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...common.files import check_path, write_atomic
from ...scene.scene import Scene
from ...system.other_inertias import nominal
from ...system.state_fields import arrays_of
from ..over_time import OverTime
from ..trajectory_files import about_robot
from ..zarr_files import write_zarr


def save(
    members: OverTime,
    scenes: Sequence[Scene],
    failures: Mapping[int, tuple[float, str]],
    path: str | Path,
) -> None:
    """Write the states of all members; the suffix, .npz or .zarr, decides.

    scenes: theirs.  failures: of members that did not come to their end, the time reached and the
    reason.
    One array per field of State, (N, T, …), `t`, (T,), and of the members `failure`, (N,), why one
    stopped, "" for none, and `reached`, (N,) [s]; and what `Trajectory.save` writes of the robot,
    of which `parameter_values` are (N, …) and those of the forces too, and `gravity` (N, 3).
    zarr: a folder with these arrays, text as its attributes; needs the package zarr.
    Either the whole file is written or none.  Raises InputError for another suffix or a folder that
    does not exist, OutputError if writing fails, MissingPackageError.
    """
    path = check_path(path, (".npz", ".zarr"))
    arrays = _arrays(members, failures) | _of_scenes(scenes)
    if path.suffix == ".npz":
        write_atomic(path, lambda file: np.savez_compressed(file, **arrays))
    else:
        write_zarr(path, arrays)


def _arrays(members: OverTime, failures: Mapping[int, tuple[float, str]]) -> dict[str, Any]:
    outputs = members.outputs
    count, end = len(outputs.x), float(outputs.t[-1])
    reasons, reached = [""] * count, np.full(count, end)
    for member, (time, reason) in failures.items():
        reasons[member], reached[member] = reason, time
    return {
        **about_robot(nominal(members.system)),
        **arrays_of(outputs),
        "failure": np.array(reasons, dtype=str),
        "reached": reached,
    }


def _of_scenes(scenes: Sequence[Scene]) -> dict[str, Any]:
    """Return gravity and parameters of all members; NaN where one does not have a parameter."""
    rows = [{name: np.ravel(v) for name, v in each.parameters.items()} for each in scenes]
    sizes = {name: len(value) for row in rows for name, value in row.items()}
    gravity = {"gravity": np.array([each.system.gravity for each in scenes])}
    if not sizes:
        return gravity
    values = [
        np.concatenate([row.get(name, np.full(size, np.nan)) for name, size in sizes.items()])
        for row in rows
    ]
    return gravity | {
        "parameter_names": np.array(list(sizes), dtype=str),
        "parameter_sizes": np.array(list(sizes.values())),
        "parameter_values": np.array(values),
    }
