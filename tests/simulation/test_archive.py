"""Archives of arrays: sizes are read first, and what is no array is refused by name."""

from __future__ import annotations

import io
import resource
import zipfile
from pathlib import Path

import numpy as np
import pytest

import pinred
from pinred.simulation import archive
from pinred.simulation.recording import read_recording


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    """A recording of a short motion."""
    path = tmp_path / "traj.npz"
    pinred.simulate(pinred.load("falling_cat"), duration=0.1, times=[0.0, 0.1]).save(path)
    return path


def _with(saved: Path, **changed: object) -> Path:
    np.savez(saved, **(dict(np.load(saved)) | changed))
    return saved


@pytest.mark.slow
def test_a_bomb_is_not_unpacked(tmp_path: Path) -> None:
    """4 GB of zeros in 4 MB are refused by the sizes that the archive tells."""
    path, block = tmp_path / "bomb.npz", bytes(10_000_000)
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file,
        file.open("t.npy", "w", force_zip64=True) as member,
    ):
        for _ in range(110):
            member.write(block)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(pinred.LoadError, match=r"would take 1\.1 GB unpacked"):
        read_recording(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kB


@pytest.mark.parametrize("length", [10**12, 10**400, -1])
def test_a_header_that_lies(length: int, tmp_path: Path) -> None:
    """An array of which a header says that it is larger than the file holds is not made."""
    path, header = tmp_path / "lie.npz", io.BytesIO()
    about = {"descr": "<f8", "fortran_order": False, "shape": (length,)}
    np.lib.format.write_array_header_1_0(header, about)
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("t.npy", header.getvalue() + bytes(80))
    with pytest.raises(pinred.LoadError, match=r"no \.npz file of plain arrays"):
        archive.read_arrays(path)


def test_a_member_that_is_no_array(saved: Path) -> None:
    """It is named."""
    with zipfile.ZipFile(saved, "a") as file:
        file.writestr("energy", b"no array")
    with pytest.raises(pinred.LoadError, match="'energy' is none"):
        read_recording(saved)


@pytest.mark.parametrize("source", ["/proc/kmsg", "/dev/zero", "/etc/passwd", "../a.urdf"])
def test_files_elsewhere_are_not_opened(source: str, saved: Path) -> None:
    """A recording from somebody else opens nothing on this machine, and nothing that hangs."""
    with pytest.raises(pinred.LoadError, match="not in its own folder; if that is so, name it"):
        _ = read_recording(_with(saved, source=np.array(source))).system
    with pytest.raises(pinred.LoadError, match="cannot be loaded"):
        read_recording(saved, robot=source)


def test_files_beside_are_opened(saved: Path) -> None:
    """The robot in the recording's own folder is taken, and one that the user names."""
    (path,) = Path(pinred.__file__).parent.parent.glob("robots/falling_cat.urdf")
    beside = saved.parent / "cat.urdf"
    beside.write_bytes(path.read_bytes())
    cat = pinred.load(beside, gravity=[0.0, 0.0, 0.0])
    traj = pinred.simulate(cat, seed=0, duration=0.1, times=[0.0, 0.1])
    traj.save(saved)
    assert read_recording(saved).system.name == "cat"
    elsewhere = saved.parent / "elsewhere"
    elsewhere.mkdir()
    moved = saved.rename(elsewhere / "traj.npz")
    with pytest.raises(pinred.LoadError, match="name it"):
        _ = read_recording(moved).system
    assert read_recording(moved, robot=str(beside)).system.name == "cat"
