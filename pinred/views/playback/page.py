"""The playback page: meshcat's viewer, a motion and its controls in one HTML file."""

from __future__ import annotations

import base64
import gzip
import json
import re
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ...common.errors import LoadError
from ...common.files import check_path, write_atomic
from ...common.waiting import Wait
from ...system.system import System
from ..motion_source import MotionSource
from .drawn_bodies import Bodies, drawn_bodies
from .playback import Playback, ShapePanel, playback, shape_panel
from .scene_nodes import frame
from .view_options import LOOK, View

# The page contains the viewer, so it must contain the viewer's licences.
_LICENCES = ("viewer/LICENSE", "viewer/dist/main.min.js.THIRD_PARTY_LICENSES.json")
STAGE = ("field.js", "overlays.js", "stage.js")  # scripts that all pages with a robot share
_SCRIPTS = (*STAGE, "panel.js", "player.js")


def page(source: MotionSource, view: View) -> bytes:
    """Build the HTML page that plays a motion. Raises the same errors as `playback`."""
    film = playback(source, view)
    bodies = drawn_bodies(film.system, meshes=view.meshes)
    panel = shape_panel(film.system, film.x, film.xdot, view.pair)
    blob = Blob()
    head = _head(film, bodies, panel, view, blob)
    return assemble(resource("page.html"), head, blob, map(resource, _SCRIPTS))


def assemble(template: str, head: Mapping[str, Any], blob: Blob, scripts: Iterable[str]) -> bytes:
    """Build a self-contained page with meshcat's viewer.

    Args:
        template: HTML with placeholders %HEAD%, %BLOB%, %STYLE%, %MESHCAT%, %LICENCES%, %SCRIPT%,
            %LOADER%.  Viewer and arrays are compressed.
        head: Data of the scripts, with arrays as entries of the blob.
        blob: The arrays.
        scripts: Texts of the scripts, in order.
    Returns:
        The page in UTF-8.
    Raises:
        LoadError: meshcat's viewer is not installed.
    """
    contents = {
        "%HEAD%": json.dumps(head, allow_nan=False).replace("<", "\\u003c"),
        "%BLOB%": _packed(bytes(blob.data)),
        "%STYLE%": resource("style.css"),
        "%MESHCAT%": _viewer(),
        "%LICENCES%": "\n".join(
            _meshcat(name).replace("</script", "<\\/script") for name in _LICENCES
        ),
        "%SCRIPT%": "".join(scripts),
        "%LOADER%": resource("loader.js"),
    }
    pieces = re.split("(%[A-Z]+%)", template)
    return "".join(contents.get(piece, piece) for piece in pieces).encode("utf-8")


@Wait("writes the page of a motion")
def save_html(source: MotionSource, path: str | Path, view: View) -> int:
    """Write the page to a .html file; if this fails, an existing file is kept.

    Args:
        source: The motion.
        path: The file.
        view: Options of the drawing.
    Returns:
        Size of the file in bytes.
    """
    path = check_path(path, (".html",))
    content = page(source, view)
    write_atomic(path, lambda file: file.write(content))
    return len(content)


class Blob:
    """Concatenated bytes of arrays; the page's head stores their offsets."""

    _TYPES: ClassVar[dict[str, type[np.generic]]] = {
        "f4": np.float32, "f8": np.float64, "u4": np.uint32,
    }  # fmt: skip

    def __init__(self) -> None:
        """Start without arrays."""
        self.data = bytearray()

    def add(self, array: NDArray[Any], kind: str = "f4") -> dict[str, Any]:
        """Append an array and return its type, offset and length."""
        self.data += bytes(-len(self.data) % 8)  # JavaScript requires aligned arrays
        flat = np.ascontiguousarray(array, dtype=np.dtype(self._TYPES[kind]).newbyteorder("<"))
        entry = {"type": kind, "at": len(self.data), "count": flat.size}
        self.data += flat.tobytes()
        return entry


def _head(
    film: Playback, bodies: Bodies, panel: ShapePanel | None, view: View, blob: Blob
) -> dict[str, Any]:
    """Return the data of the page's script, with arrays moved to the blob."""
    largest = float(np.linalg.norm(film.momentum.vector, axis=1).max())
    return (
        plain_fields(frame(film, bodies))
        | robot_head(film.system, bodies, blob)
        | {
            "speed": view.speed,
            "t": blob.add(film.t, "f8"),
            "placements": blob.add(film.placements),
            "com": blob.add(film.com),
            "ellipsoid": blob.add(film.ellipsoid),
            "momentum": {**_packed_fields(film.momentum, blob), "largest": largest},
            "ghost": film.ghost and _packed_fields(film.ghost, blob),
            "impacts": _plain(film.impacts),
            "sphere": film.sphere and _packed_fields(film.sphere, blob),
            "panel": panel and {**_packed_fields(panel, blob), "fine": panel.field.shape[-1]},
        }
    )


def robot_head(system: System, bodies: Bodies, blob: Blob) -> dict[str, Any]:
    """Return the robot's names, shapes and look for `stage.js`, with arrays moved to the blob."""
    balls, names = {joint.name for joint in system.space.balls}, list(system.sorted_model.names)
    return {
        "look": vars(LOOK),
        "title": system.name or "robot",
        "note": bodies.note,
        "joints": names,
        "balls": [k for k, name in enumerate(names) if name in balls],
        "meshes": [
            {"vertices": blob.add(mesh.vertices), "faces": blob.add(mesh.faces, "u4")}
            for mesh in bodies.meshes
        ],
        "solids": [plain_fields(solid) for solid in bodies.solids],
    }


def plain_fields(value: object) -> dict[str, Any]:
    """Return the fields of a dataclass with arrays as lists."""
    return {name: _plain(entry) for name, entry in vars(value).items()}


def _packed_fields(value: object, blob: Blob) -> dict[str, Any]:
    """Return the fields of a dataclass with arrays moved to the blob."""
    return {
        name: blob.add(entry) if isinstance(entry, np.ndarray) else entry
        for name, entry in vars(value).items()
    }


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value


def resource(name: str) -> str:
    """Read a file of this package."""
    return files(__package__).joinpath(name).read_text(encoding="utf-8")


@cache
def _viewer() -> str:
    """Return meshcat's viewer, compressed."""
    return _packed(_meshcat("viewer/dist/main.min.js").encode("utf-8"))


def _packed(data: bytes) -> str:
    """Compress bytes for a script element; `loader.js` unpacks them."""
    return base64.b64encode(gzip.compress(data, mtime=0)).decode("ascii")


def _meshcat(name: str) -> str:
    """Read a file of meshcat's Python package.

    Args:
        name: Path in the package.
    Returns:
        Its text.
    Raises:
        LoadError: The file is missing.
    """
    spec = find_spec("meshcat")
    for folder in (spec.submodule_search_locations or ()) if spec else ():
        if (file := Path(folder, name)).is_file():
            return file.read_text(encoding="utf-8")
    raise LoadError(f"meshcat's {name} was not found; pip install 'meshcat>=0.3.2'")
