"""Names that no file can have, and those of folders, devices and pipes, are refused."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import pinred
from pinred.laboratory.bench import read_record

NAMES = [
    "", "\0", "a\0b{}", "\ud800{}", "/\ud800/a{}", "a" * 300 + "{}", "a/" * 3000 + "b{}", "..",
    "/dev/zero", "/dev/null", "/dev/zero/a{}", "folder{}", "loop{}", "pipe{}",
]  # fmt: skip


@pytest.mark.parametrize("name", NAMES, ids=lambda name: ascii(name)[:20])
def test_names_of_no_plain_file_are_refused(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Readers and writers raise errors of pinred, and wait for no device or pipe."""
    monkeypatch.chdir(tmp_path)
    scene = pinred.Scene(system=pinred.load("falling_cat"), duration=0.05)
    traj = pinred.simulate(scene)
    vary = {"front.mass": [1.0]}
    calls: list[tuple[str, Callable[[Any], Any]]] = [
        (".npz", pinred.read_recording), (".npz", pinred.read_members),
        (".zarr", pinred.read_members), (".urdf", pinred.load), (".xml", pinred.load),
        (".toml", pinred.load_scene), (".toml", pinred.load_gait), (".csv", pinred.Gait.read),
        (".zarr", pinred.open_sweep), (".csv", lambda path: read_record(Path(path))),
        (".zarr", lambda path: pinred.sweep(scene, vary, outputs=["x"], store=path)),
        (".npz", traj.save), (".csv", traj.save), (".zarr", traj.save), (".urdf", save_model),
    ]  # fmt: skip
    for suffix, call in calls:
        path = name.format(suffix)
        if name == "folder{}":
            Path(path).mkdir(exist_ok=True)
        elif name == "pipe{}" and not Path(path).exists():
            os.mkfifo(path)
        elif name == "loop{}" and not Path(path).is_symlink():
            Path(path).symlink_to(path)
        if name == "loop{}" and call == traj.save:
            continue  # A file replaces the link.
        for given in (path, Path(path)):
            with pytest.raises(pinred.PinredError):
                call(given)


def save_model(path: Any) -> None:
    """Write a robot file."""
    pinred.Model("m").save(path)
