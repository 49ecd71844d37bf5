"""Archives of arrays: sizes are checked first, and other contents are rejected by name."""

from __future__ import annotations

import io
import resource
import shutil
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinred
from pinred.simulation.read_recording import read_arrays, read_recording
from pinred.system.find_robot_files import bundled_robots


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    """Return the file of a short motion."""
    path = tmp_path / "traj.npz"
    pinred.simulate(pinred.load("falling_cat"), duration=0.1, times=[0.0, 0.1]).save(path)
    return path


def _with(saved: Path, **changed: object) -> Path:
    np.savez(saved, **(dict(np.load(saved)) | changed))
    return saved


@pytest.mark.slow
def test_archive_bomb_is_not_unpacked(tmp_path: Path) -> None:
    """1.1 GB of zeros in 5 MB are rejected by the sizes that the archive states."""
    path, count = tmp_path / "bomb.npz", 110
    deflate = zlib.compressobj(1, zlib.DEFLATED, -zlib.MAX_WBITS)
    block = deflate.compress(bytes(10_000_000)) + deflate.flush(zlib.Z_FULL_FLUSH)
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("t.npy", block * count + deflate.flush())
        (member,) = file.filelist  # the table at the end of the file, not yet written
        member.compress_type, member.file_size = zipfile.ZIP_DEFLATED, 10_000_000 * count
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(pinred.LoadError, match=r"would take 1\.1 GB unpacked"):
        read_recording(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kB


@pytest.mark.parametrize("length", [10**12, 10**400, -1])
def test_header_with_wrong_size_is_rejected(length: int, tmp_path: Path) -> None:
    """An array larger than its file is not allocated."""
    path, header = tmp_path / "lie.npz", io.BytesIO()
    about = {"descr": "<f8", "fortran_order": False, "shape": (length,)}
    np.lib.format.write_array_header_1_0(header, about)
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("t.npy", header.getvalue() + bytes(80))
    with pytest.raises(pinred.LoadError, match=r"not an \.npz file of plain arrays"):
        read_arrays(path)


def test_member_that_is_no_array_is_named(saved: Path) -> None:
    """The message names a member that is not an array."""
    with zipfile.ZipFile(saved, "a") as file:
        file.writestr("energy", b"no array")
    with pytest.raises(pinred.LoadError, match="'energy' is not an array"):
        read_recording(saved)


@pytest.mark.parametrize("source", ["/proc/kmsg", "/dev/zero", "/etc/passwd", "../a.urdf"])
def test_recording_opens_no_other_files(source: str, saved: Path) -> None:
    """The robot of a recording cannot be a device or a file in another folder."""
    with pytest.raises(pinred.LoadError, match=r"in another folder\. If you trust it, name it"):
        _ = read_recording(_with(saved, source=np.array(source))).system
    with pytest.raises(pinred.LoadError, match="cannot be loaded"):
        read_recording(saved, robot=source)


def test_recording_loads_robot_from_its_folder(saved: Path) -> None:
    """A robot in the folder of the recording is loaded, and one that the user names."""
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


@pytest.mark.parametrize("suffix", [".npz", ".zarr"])
def test_robot_file_that_is_a_link_is_refused(suffix: str, tmp_path: Path) -> None:
    """A link in the folder of a recording could name any file; a plain file there is loaded."""
    inside, outside = tmp_path / "inside", tmp_path / "outside"
    inside.mkdir()
    outside.mkdir()
    robot = outside / "cat.urdf"
    shutil.copyfile(bundled_robots()["falling_cat"].path, robot)
    path = inside / f"m{suffix}"
    if suffix == ".npz":
        pinred.simulate(pinred.load(robot, gravity=[0.0, 0.0, 0.0]), seed=0, duration=0.1).save(
            path
        )
    else:
        many = pinred.simulate_many(
            pinred.load(robot, gravity=[0.0, 0.0, 0.0]), seeds=[0, 1], duration=0.1
        )
        many.save(path)

    def read() -> pinred.System:
        return (pinred.read_recording if suffix == ".npz" else pinred.read_members)(path).system

    (inside / "cat.urdf").symlink_to(robot)
    with pytest.raises(pinred.LoadError, match=r"'cat\.urdf', which is a link to another folder"):
        read()
    (inside / "cat.urdf").unlink()
    (inside / "cat.urdf").symlink_to("other.urdf")
    shutil.copyfile(robot, inside / "other.urdf")
    assert read().shape_names == ("bend", "sway", "twist")
    # The folder of a recording may itself be reached by a link.
    (tmp_path / "link").symlink_to(inside)
    path = tmp_path / "link" / path.name
    assert read().shape_names == ("bend", "sway", "twist")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return the arrays of a recording."""
    path = tmp_path_factory.mktemp("recorded") / "m.npz"
    pinred.simulate(pinred.load("falling_cat"), duration=0.1).save(path)
    return dict(np.load(path))


@pytest.mark.parametrize(
    "source",
    ["a\0b.urdf", "a\0b", "/a\0b/c.urdf", "\ud800.urdf", "x" * 300 + ".urdf", "y" * 300,
     "a/" * 3000 + "c.urdf", "loop.urdf", "folder.urdf", "..", "/", "/dev/zero", "~/x.urdf"],
)  # fmt: skip
def test_robot_name_that_is_no_file_name_is_refused(
    source: str, recorded: dict[str, Any], tmp_path: Path
) -> None:
    """Names in files may be invalid, or those of folders, devices and loops of links."""
    path = tmp_path / "m.npz"
    (tmp_path / "loop.urdf").symlink_to("loop.urdf")
    (tmp_path / "folder.urdf").mkdir()
    np.savez(path, **recorded | {"source": np.array(source)})
    recording = pinred.read_recording(path)
    with pytest.raises(pinred.LoadError):
        _ = recording.system
