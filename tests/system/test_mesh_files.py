"""Meshes are read in a child process, which damaged files may end."""

from __future__ import annotations

import os
import signal
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from pinred.common.errors import LoadError
from pinred.system import mesh_process, urdf_shapes
from pinred.system.urdf_shapes import Mesh, Unreadable, read_meshes

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def stl(corners: np.ndarray = CORNERS, count: int = 4) -> bytes:
    """Return a binary STL file of a tetrahedron, with a number of triangles in its header."""
    triangles = [np.append(np.zeros(3), corners[face].ravel()) for face in FACES]
    rows = b"".join(struct.pack("<12fH", *row, 0) for row in triangles)
    return bytes(80) + struct.pack("<I", count) + rows


def collada(nodes: str) -> bytes:
    """Return a COLLADA file with a scene of nodes, whose meshes are one triangle."""
    positions = '<float_array id="p" count="9">0 0 0 1 0 0 0 1 0</float_array>'
    accessor = "".join(f'<param name="{axis}" type="float"/>' for axis in "XYZ")
    return (
        '<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" '
        'version="1.4.1"><library_geometries><geometry id="g"><mesh><source id="s">'
        f'{positions}<technique_common><accessor source="#p" count="3" stride="3">{accessor}'
        '</accessor></technique_common></source><vertices id="v"><input semantic="POSITION" '
        'source="#s"/></vertices><triangles count="1"><input semantic="VERTEX" source="#v" '
        'offset="0"/><p>0 1 2</p></triangles></mesh></geometry></library_geometries>'
        f'<library_visual_scenes><visual_scene id="w">{nodes}</visual_scene>'
        '</library_visual_scenes><scene><instance_visual_scene url="#w"/></scene></COLLADA>'
    ).encode()


LEAF = '<instance_geometry url="#g"/>'
ITSELF = f'<node id="n">{LEAF}<instance_node url="#n"/></node>'
DEEP = "<node>" * 20_000 + LEAF + "</node>" * 20_000
ENDED = r"ended the process that read it"

FILES: list[tuple[str, bytes, str]] = [
    ("itself.dae", collada(ITSELF), ENDED),
    ("deep.dae", collada(DEEP), ENDED),
    ("truncated.stl", stl()[:200], "cannot be read: Could not load"),
    ("count.stl", stl(count=2**32 - 1), "cannot be read: Could not load"),
    ("nan.stl", stl(np.full((4, 3), np.nan)), "cannot be read: its vertices are not finite"),
    ("index.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99\n", "cannot be read: Could not load"),
    ("points.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "cannot be read: "),
    ("empty.stl", b"", "is empty"),
]


@pytest.fixture(autouse=True)
def _no_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(urdf_shapes, "_CACHE", urdf_shapes.MeshCache())


def reason(result: Mesh | Unreadable) -> str:
    """Return why a mesh cannot be read."""
    assert isinstance(result, Unreadable)
    return result.reason


def children(monkeypatch: pytest.MonkeyPatch) -> list[subprocess.Popen[bytes]]:
    """Return a list to which each child process of this process is appended."""
    processes: list[subprocess.Popen[bytes]] = []
    start = subprocess.Popen

    def record(*args: object, **options: object) -> subprocess.Popen[bytes]:
        processes.append(start(*args, **options))  # type: ignore[call-overload]
        return processes[-1]

    monkeypatch.setattr(subprocess, "Popen", record)
    return processes


def test_hostile_files_leave_other_meshes_intact(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two files end the child process, so three children read all files."""
    processes = children(monkeypatch)
    paths = [tmp_path / "first.stl"]
    for name, content, _ in FILES:
        paths += [tmp_path / name, tmp_path / f"{name}.good.stl"]
        paths[-2].write_bytes(content)
    for path in paths[::2]:
        path.write_bytes(stl())
    results = read_meshes(paths)
    for path, (_, _, why) in zip(paths[1::2], FILES, strict=True):
        assert reason(results[path]).startswith(why), path
    for path in paths[::2]:
        mesh = results[path]
        assert isinstance(mesh, Mesh)
        assert sorted(map(tuple, mesh.vertices)) == sorted(map(tuple, CORNERS))
        volume = sum(np.linalg.det(mesh.vertices[face]) for face in mesh.faces) / 6.0
        assert volume == pytest.approx(1.0)
    assert len(processes) == 3
    assert all(process.returncode is not None for process in processes)


@pytest.mark.parametrize("kind", ["pipe", "device", "folder", "gone", "large"])
def test_only_regular_files_are_read(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A pipe would wait for a writer, and a device is endless; no process is started."""
    processes, path = children(monkeypatch), tmp_path / "mesh.stl"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "folder":
        path.mkdir()
    elif kind == "large":
        with path.open("wb") as file:
            file.truncate(urdf_shapes.MOST_BYTES + 1)
    expected = {"gone": "does not exist", "large": "is larger than 256 MB"}
    assert reason(read_meshes([path])[path]) == expected.get(kind, "is not a regular file")
    assert processes == []


def test_unchanged_files_are_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also those that end the process.  A changed file is read again."""
    processes = children(monkeypatch)
    good, bad = tmp_path / "good.stl", tmp_path / "bad.dae"
    good.write_bytes(stl())
    bad.write_bytes(collada(ITSELF))
    first = read_meshes([good, bad, good])
    assert len(processes) == 1
    again = read_meshes([bad, good])
    assert len(processes) == 1
    assert again[good] is first[good]
    assert again[bad] is first[bad]
    bad.write_bytes(collada(f"<node>{LEAF}</node>"))
    mesh = read_meshes([bad])[bad]
    assert isinstance(mesh, Mesh)
    assert mesh.faces.shape == (1, 3)
    assert read_meshes([]) == {}


def test_cache_drops_the_least_recent_meshes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its size is bounded."""
    monkeypatch.setattr(urdf_shapes, "_KEPT", 1000)
    cache, mesh = urdf_shapes.MeshCache(), Mesh(np.zeros((12, 3)), np.zeros((10, 3), np.uint32))
    for k in range(3):
        cache.put((0, k, 0, 0), mesh)
        if k < 2:
            assert cache.get((0, 0, 0, 0)) is mesh
    assert [cache.get((0, k, 0, 0)) is mesh for k in range(3)] == [True, False, True]


POLYGON = " ".join(str(k % 4 + 1) for k in range(200_000))
SLOW = "\n".join(["v 0 0 0", "v 1 0 0", "v 0 1 0", "v 0 0 1", f"f {POLYGON}"])


@pytest.mark.parametrize("limit", ["_SECONDS", "_SECONDS_TOGETHER"])
def test_mesh_that_takes_too_long_is_given_up(
    limit: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A polygon with 200,000 corners takes minutes."""
    path = tmp_path / "slow.obj"
    path.write_text(SLOW)
    monkeypatch.setattr(urdf_shapes, limit, 0.3)
    expected = "was not read within 0.3 s"
    together = limit == "_SECONDS_TOGETHER"
    began = time.monotonic()
    assert reason(read_meshes([path])[path]) == expected + " for all meshes" * together
    assert time.monotonic() - began < 40.0


def test_memory_of_the_child_is_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Libraries need 150 MB, and four million vertices need as much again."""
    path = tmp_path / "long.obj"
    path.write_bytes(b"v 0 0 0\n" * 4_000_000 + b"v 1 0 0\nv 0 1 0\nf 1 4000001 4000002\n")
    monkeypatch.setattr(urdf_shapes, "_MEMORY", 250_000_000)
    assert reason(read_meshes([path])[path])


def test_too_many_triangles_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The limit counts vertices and triangles."""
    path = tmp_path / "mesh.stl"
    path.write_bytes(stl())
    monkeypatch.setattr(urdf_shapes, "_MOST", 7)
    assert "more than 7 vertices and triangles" in reason(read_meshes([path])[path])


def test_interrupt_ends_the_child(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C is answered at once, and no process is left."""
    processes, path = children(monkeypatch), tmp_path / "slow.obj"
    path.write_text(SLOW)

    def interrupt() -> None:
        while not processes:
            time.sleep(0.01)
        time.sleep(0.5)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        read_meshes([path])
    thread.join()
    assert time.monotonic() - began < 40.0
    assert [process.returncode for process in processes] == [-signal.SIGKILL]


def test_child_that_does_not_start_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a system without coal, or where Python is embedded."""
    path = tmp_path / "mesh.stl"
    path.write_bytes(stl())
    for executable in ("/bin/true", str(tmp_path / "gone")):
        monkeypatch.setattr(sys, "executable", executable)
        with pytest.raises(LoadError, match="process that reads meshes did not start"):
            read_meshes([path])


def test_program_of_the_child_imports_nothing_of_pinred() -> None:
    """Relative imports would fail, because it runs as a file."""
    text = Path(mesh_process.__file__).read_text("utf-8")
    assert "from ." not in text
    assert "pinred." not in text
