"""Motions that commands show: read from a .npz file, or simulated from a scene file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..common.errors import InputError

if TYPE_CHECKING:
    from ..views.motion_source import MotionSource


def motion_in(path: str, robot: str | None) -> MotionSource:
    """Return the motion in a .npz file, or simulate a scene file.

    `robot` names the robot of a .npz file that does not name one itself.
    """
    check_robot(path, robot)
    if Path(path).suffix == ".npz":
        from ..simulation.recording import read_recording

        return read_recording(path, robot)
    from ..scene.toml.reader import read_scene_file
    from ..simulation.simulate import simulate

    file = read_scene_file(path)
    return simulate(file.scene, engine=file.engine, progress=True)


def check_robot(source: str, robot: str | None) -> None:
    """Raise InputError for the option --robot with any source except a .npz file."""
    if robot is not None and Path(source).suffix != ".npz":
        raise InputError(f"--robot applies to .npz files only; '{source}' names its robot")
