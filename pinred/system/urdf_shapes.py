"""read_shapes(): the visual shapes of a URDF file, with meshes read in a child process.

A ball replaces each mesh in the text for Pinocchio, so that Pinocchio reads the mesh's placement
and colour, but not its file.

The parsers of mesh files crash, hang or exhaust the memory on some damaged files.  Therefore a
child process with limits reads all meshes of a robot.  If a mesh ends it, another child reads the
meshes that remain.  Results are cached by the identity of the file, so a second reading is free.
"""

from __future__ import annotations

import json
import os
import select
import signal
import stat
import subprocess
import sys
import tempfile
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Lock
from time import monotonic
from typing import IO, TypeAlias
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..common.errors import LoadError
from ..common.names import plain, plain_path, quoted
from . import mesh_process
from .find_robot_files import Visuals, library_output, read_xml
from .mesh_process import HEADER, READY
from .read_urdf import URDFDOM, take_closing_joints, with_deep_stack
from .urdf_elements import prepare, reduced_text, replace_commas, tree_depth

_MOST_LINKS = 2000  # Pinocchio's time for shapes is quadratic in the number of links.
FARTHEST = 1e6  # largest accepted coordinate or size of a shape [m]
MOST_BYTES = 256_000_000  # largest accepted size of a mesh file [byte]
_SECONDS = 10.0  # time limit of each mesh [s]
_SECONDS_TOGETHER = 60.0  # time limit of all meshes of a robot [s]
_MEMORY = 4_000_000_000  # limit of the address space of the child process [byte]
_MOST = 5_000_000  # largest accepted number of vertices and triangles of a mesh
_KEPT = 256_000_000  # largest total size of the cached meshes [byte]
_CHUNK = 1 << 20  # number of bytes that are read from the child process at once
_GRACE = 1.0  # time in which a child process ends after it has closed its output [s]

_Identity: TypeAlias = tuple[int, int, int, int]


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh.

    Attributes:
        vertices: Positions, (V, 3) [m].
        faces: Indices of vertices, (T, 3).
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.uint32]


@dataclass(frozen=True)
class Unreadable:
    """A mesh file that cannot be read.

    Attributes:
        reason: What is wrong with the file, as the end of a sentence.
    """

    reason: str


def unreadable(path: Path) -> Unreadable | None:
    """Return why a file is not given to a parser of meshes, or None."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return Unreadable("does not exist")
    if not stat.S_ISREG(status.st_mode):
        return Unreadable("is not a regular file")
    if status.st_size == 0:  # also the operating system's virtual files, which may be endless
        return Unreadable("is empty")
    if status.st_size > MOST_BYTES:
        return Unreadable(f"is larger than {MOST_BYTES // 10**6} MB")
    return None


def read_meshes(paths: Sequence[Path]) -> dict[Path, Mesh | Unreadable]:
    """Read the meshes in files, each at most once while the file is unchanged.

    Args:
        paths: Files.
    Returns:
        The mesh of each file, or the reason why it cannot be read.
    """
    meshes: dict[Path, Mesh | Unreadable] = {}
    remaining: dict[Path, _Identity] = {}
    for path in dict.fromkeys(paths):
        result: Mesh | Unreadable | None = unreadable(path)
        if result is None:
            identity = _identity(path)
            result = _CACHE.get(identity)
            if result is None:
                remaining[path] = identity
                continue
        meshes[path] = result
    deadline = monotonic() + _SECONDS_TOGETHER
    while remaining:
        for path, mesh in _read_in_child(list(remaining), deadline):
            _CACHE.put(remaining.pop(path), mesh)
            meshes[path] = mesh
        if monotonic() > deadline:
            late = Unreadable(f"was not read within {_SECONDS_TOGETHER:g} s for all meshes")
            return meshes | dict.fromkeys(remaining, late)
    return meshes


def _identity(path: Path) -> _Identity:
    status = path.stat()
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns


class MeshCache:
    """The most recent meshes of this process, by file, up to a total size."""

    def __init__(self) -> None:
        """Create an empty cache."""
        self._meshes: OrderedDict[_Identity, Mesh | Unreadable] = OrderedDict()
        self._lock = Lock()

    def get(self, identity: _Identity) -> Mesh | Unreadable | None:
        """Return the result for a file, or None."""
        with self._lock:
            if identity in self._meshes:
                self._meshes.move_to_end(identity)
            return self._meshes.get(identity)

    def put(self, identity: _Identity, mesh: Mesh | Unreadable) -> None:
        """Store the result for a file, and drop the least recent results above the limit."""
        with self._lock:
            self._meshes[identity] = mesh
            while sum(map(_size, self._meshes.values())) > _KEPT:
                self._meshes.popitem(last=False)


_CACHE = MeshCache()


def _size(mesh: Mesh | Unreadable) -> int:
    return mesh.vertices.nbytes + mesh.faces.nbytes if isinstance(mesh, Mesh) else len(mesh.reason)


def _read_in_child(paths: list[Path], deadline: float) -> Iterator[tuple[Path, Mesh | Unreadable]]:
    """Yield the meshes of leading files, up to the first file that ends the child process."""
    with _child(paths) as (process, output):
        read = partial(_receive, output, deadline)
        if read(len(READY)) != READY:
            if monotonic() > deadline:
                return
            raise LoadError("the process that reads meshes did not start")
        for path in paths:
            mesh = _next_mesh(read)
            if mesh is None and monotonic() > deadline:
                return
            yield path, _ending(process) if mesh is None else mesh
            if mesh is None:
                return


@contextmanager
def _child(paths: list[Path]) -> Iterator[tuple[subprocess.Popen[bytes], IO[bytes]]]:
    """Start the child process, yield it with its output, and end it.  Raises LoadError."""
    request = {
        "files": [str(path) for path in paths],
        "path": sys.path,
        "seconds": _SECONDS,
        "memory": _MEMORY,
        "most": _MOST,
    }
    # Without `site` and without threads of NumPy, the process starts faster.
    command = [sys.executable, "-I", "-S", mesh_process.__file__]
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    with tempfile.TemporaryFile() as file:
        file.write(json.dumps(request).encode())
        file.seek(0)
        try:
            process = subprocess.Popen(
                command,
                stdin=file,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env=environment,
                bufsize=0,
            )
        except OSError as error:
            raise LoadError(f"the process that reads meshes did not start: {error}") from None
    assert process.stdout is not None
    try:
        yield process, process.stdout
    finally:  # also after Ctrl-C
        process.kill()
        process.stdout.close()
        process.wait()


def _receive(output: IO[bytes], deadline: float, count: int) -> bytes | None:
    """Return bytes of a pipe; None if it ends or the deadline passes before."""
    data, poll = bytearray(), select.poll()
    poll.register(output, select.POLLIN)
    while len(data) < count:
        if not poll.poll(1000.0 * max(0.0, deadline - monotonic())):
            return None
        chunk = output.read(min(_CHUNK, count - len(data)))
        if not chunk:
            return None
        data += chunk
    return bytes(data)


def _next_mesh(read: Callable[[int], bytes | None]) -> Mesh | Unreadable | None:
    """Return the mesh in the next record; None if the record is not complete."""
    header = read(HEADER.size)
    if header is None:
        return None
    vertices, faces = HEADER.unpack(header)
    if vertices < 0:
        text = read(faces)
        return None if text is None else Unreadable(f"cannot be read: {_message(text)}")
    data = read(24 * vertices + 12 * faces)
    if data is None:
        return None
    positions = np.frombuffer(data, "<f8", 3 * vertices).reshape(-1, 3)
    indices = np.frombuffer(data, "<u4", 3 * faces, 24 * vertices).reshape(-1, 3)
    if vertices == 0 or faces == 0:
        return Unreadable("contains no triangles")
    if int(indices.max()) >= vertices:
        return Unreadable("has triangles whose vertices do not exist")
    return Mesh(positions, indices)


def _message(text: bytes) -> str:
    """Return a parser's message in one line, without its C++ source location and hint."""
    words = text.decode(errors="replace")
    words = (words.rpartition("message:")[2] or words).partition("Hint:")[0]
    return plain(words, 200)


def _ending(process: subprocess.Popen[bytes]) -> Unreadable:
    """Return the reason for which a mesh ended the child process."""
    try:
        code = process.wait(_GRACE)
    except subprocess.TimeoutExpired:
        return Unreadable("ended the process that read it")
    if code == -signal.SIGALRM:
        return Unreadable(f"was not read within {_SECONDS:g} s")
    name = signal.strsignal(-code) if code < 0 else f"code {code}"
    return Unreadable(f"ended the process that read it ({name})")


@dataclass(frozen=True)
class MeshShape:
    """A visual shape that is a mesh.

    Attributes:
        name: Name of the shape in Pinocchio's geometry model.
        link: Name of its link.
        file: Name of the mesh file, as written in the URDF file.
        scale: Factors along the axes of the mesh, as written in the URDF file.
    """

    name: str
    link: str
    file: str
    scale: str

    def __str__(self) -> str:
        return f"mesh '{plain_path(self.file)}' of link {quoted(self.link)}"


@dataclass(frozen=True)
class Shapes:
    """The visual shapes of a URDF file.

    Attributes:
        visuals: Model of the file and its shapes; a ball stands for each mesh.
        meshes: Mesh of each ball by its name, or why the mesh is not drawn.
        unreadable: Messages about meshes that are not drawn.
    """

    visuals: Visuals
    meshes: Mapping[str, Mesh | None]
    unreadable: tuple[str, ...]


def read_shapes(path: Path, folders: Sequence[str]) -> Shapes:
    """Read the visual shapes of a URDF file.

    Args:
        path: The file.
        folders: Additional search folders for meshes or packages.
    Returns:
        The shapes.
    Raises:
        LoadError: The file cannot be read.
        ValueError: Pinocchio cannot read the shapes.
    """
    # Packages are searched in all parent folders of the file, in `folders`, and next to them.
    named = [path for folder in folders for path in (folder, str(Path(folder).parent))]
    above = [str(folder) for folder in path.resolve().parents][:-1]
    robot = read_xml(path)
    replace_commas(robot)
    if (links := len(robot.findall("link"))) > _MOST_LINKS:
        raise LoadError(f"{plain_path(path)} has {links} links; at most {_MOST_LINKS} are drawn")
    prepare(robot)
    take_closing_joints(robot)
    meshes = _take_meshes(robot)
    text = reduced_text(robot, shapes=True)

    def parse() -> Visuals:
        raw = pin.buildModelFromXML(text)
        return Visuals(raw, pin.buildGeomFromUrdfString(raw, text, pin.GeometryType.VISUAL))

    with library_output(URDFDOM):
        visuals = with_deep_stack(parse, tree_depth(robot))
    results = _meshes_of(meshes, [*named, *above])
    unreadable = tuple(
        f"{shape} {result.reason}"
        for shape, result in results.items()
        if isinstance(result, Unreadable)
    )
    drawn = {
        shape.name: result if isinstance(result, Mesh) else None
        for shape, result in results.items()
    }
    return Shapes(visuals, drawn, unreadable)


def _take_meshes(robot: Element) -> tuple[MeshShape, ...]:
    """Replace the meshes of visual shapes by balls, in place.

    Args:
        robot: Root element of a URDF file.
    Returns:
        The meshes.
    """
    shapes = []
    for link, name, geometry in _geometries(robot):
        mesh = geometry[0]
        shapes.append(MeshShape(name, link, mesh.get("filename", ""), mesh.get("scale", "1 1 1")))
        mesh.tag = "sphere"
        mesh.attrib.clear()
        mesh.set("radius", "1")
    return tuple(shapes)


def _geometries(robot: Element) -> Iterator[tuple[str, str, Element]]:
    """Yield link, shape name and geometry element of each visual shape that is a mesh."""
    for link in robot.findall("link"):
        name = link.get("name", "")
        for number, visual in enumerate(link.findall("visual")):
            geometry = visual.find("geometry")
            if geometry is not None and len(geometry) and geometry[0].tag == "mesh":
                yield name, f"{name}_{number}", geometry


def _meshes_of(
    shapes: Sequence[MeshShape], folders: Sequence[str]
) -> dict[MeshShape, Mesh | Unreadable]:
    """Return the mesh of each shape in its scale, or why it cannot be drawn."""
    paths = {shape.file: _find(shape.file, folders) for shape in shapes}
    meshes = read_meshes([path for path in paths.values() if path is not None])
    scaled: dict[tuple[Path | None, str], Mesh | Unreadable] = {}
    for path, scale in {(paths[shape.file], shape.scale) for shape in shapes}:
        mesh = Unreadable("could not be found") if path is None else meshes[path]
        scaled[path, scale] = mesh if isinstance(mesh, Unreadable) else _scaled(mesh, scale)
    return {shape: scaled[paths[shape.file], shape.scale] for shape in shapes}


def _find(name: str, folders: Sequence[str]) -> Path | None:
    """Return the path of a mesh file; None if there is none."""
    scheme, mark, location = name.partition("://")
    if not mark or scheme == "file":
        folders, location = ([*folders, ""] if not mark else [""]), location if mark else name
    elif scheme not in ("package", "model"):
        return None
    for folder in folders:
        path = Path(folder, location)
        if location and _exists(path):
            return path
    return None


def _exists(path: Path) -> bool:
    try:
        return path.exists() and not path.is_dir()
    except (OSError, ValueError):
        return False


def _scaled(mesh: Mesh, scale: str) -> Mesh | Unreadable:
    try:
        factors = np.array([float(word) for word in scale.split()])
    except ValueError:
        factors = np.empty(0)
    if factors.shape != (3,) or not np.isfinite(factors).all():
        return Unreadable(f"has scale {quoted(scale)}, expected three numbers")
    with np.errstate(over="ignore"):
        vertices = mesh.vertices * factors
    if not np.abs(vertices).max() <= FARTHEST:
        return Unreadable(f"has vertices farther than {FARTHEST:g} m from its origin")
    return Mesh(vertices, mesh.faces)
