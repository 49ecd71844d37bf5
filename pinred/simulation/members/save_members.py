"""Files of the members of simulate_many in the formats .npz and .zarr."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...common.files import check_path, write_atomic
from ...scene.scene import Scene
from ...system.state_fields import arrays_of
from ...system.variants import nominal
from ..over_time import OverTime
from ..trajectory_files import robot_arrays, write_zarr


def save(
    members: OverTime,
    scenes: Sequence[Scene],
    failures: Mapping[int, tuple[float, str]],
    path: str | Path,
) -> None:
    """Write the states of all members; nothing is left of a file that fails.

    The file contains `t`, (T,), one array (N, T, …) for each other field of State, and the robot
    as `Trajectory.save` writes it.  For each member there are `failure`, (N,), the reason for its
    failure or "", and `reached`, (N,), the last time [s].  `gravity` is (N, 3), and
    `parameter_values`, (N, …), include the parameters of forces.

    InputError is raised for another suffix or a folder that does not exist, OutputError if
    writing fails, and MissingPackageError if zarr is not installed.

    Args:
        members: The motions of all members.
        scenes: Their scenes.
        failures: Last time [s] and reason by the index of each member that failed.
        path: Path of the file; its suffix, .npz or .zarr, selects the format.
    """
    path = check_path(path, (".npz", ".zarr"))
    arrays = _state_arrays(members, failures) | _scene_arrays(scenes)
    if path.suffix == ".npz":
        write_atomic(path, lambda file: np.savez_compressed(file, **arrays))
    else:
        write_zarr(path, arrays)


def _state_arrays(members: OverTime, failures: Mapping[int, tuple[float, str]]) -> dict[str, Any]:
    outputs = members.outputs
    count, end = len(outputs.x), float(outputs.t[-1])
    reasons, reached = [""] * count, np.full(count, end)
    for member, (time, reason) in failures.items():
        reasons[member], reached[member] = reason, time
    return {
        **robot_arrays(nominal(members.system)),
        **arrays_of(outputs),
        "failure": np.array(reasons, dtype=str),
        "reached": reached,
    }


def _scene_arrays(scenes: Sequence[Scene]) -> dict[str, Any]:
    """Return gravity and parameters of all members, NaN for parameters that a member lacks."""
    parameters = [
        {name: np.ravel(value) for name, value in scene.parameters.items()} for scene in scenes
    ]
    sizes = {name: len(value) for values in parameters for name, value in values.items()}
    gravity = {"gravity": np.array([scene.system.gravity for scene in scenes])}
    if not sizes:
        return gravity
    entries = [
        np.concatenate([values.get(name, np.full(size, np.nan)) for name, size in sizes.items()])
        for values in parameters
    ]
    return gravity | {
        "parameter_names": np.array(list(sizes), dtype=str),
        "parameter_sizes": np.array(list(sizes.values())),
        "parameter_values": np.array(entries),
    }
