"""The playback page: meshcat's viewer, a motion and its controls in one HTML file, and its server.

meshcat's server listens on every interface. This server is bound to 127.0.0.1 and answers only
requests with that host name, so that a foreign site cannot redirect its host name to this server.
Pages are also shown inside notebook cells.
"""

from __future__ import annotations

import base64
import errno
import gzip
import json
import os
import re
import sys
import threading
import webbrowser
from collections.abc import Iterable, Mapping
from functools import cache
from html import escape
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from importlib.util import find_spec
from numbers import Integral
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ...common.errors import InputError, LoadError, OutputError
from ...common.files import check_path, write_atomic
from ...common.waiting import Wait, in_notebook
from ...system.system import System
from ..motion_source import MotionSource
from .colours_and_view_options import LOOK, View
from .drawn_bodies import Bodies, drawn_bodies
from .playback import Playback, ShapePanel, playback, shape_panel
from .scene_nodes import frame

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


HOST = "127.0.0.1"
_HEIGHT = 520  # initial height of a page in a notebook cell, whose user can resize it [px]


class Player:
    """Server of one page; it runs until close(), or the end of a `with` block or of the process.

    Attributes:
        url: Address of the page.
    """

    def __init__(self, content: bytes, port: int | None = None) -> None:
        """Serve an HTML page.

        Args:
            content: The page.
            port: Port; an unused port if None.
        """
        self._server = _listen(content, port)
        self.url = f"http://{HOST}:{self._server.server_port}/"
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.1,), daemon=True)
        self._thread.start()

    def open(self) -> None:
        """Open the page in the user's browser, if there is a display."""
        screens = ("DISPLAY", "WAYLAND_DISPLAY")
        if sys.platform != "linux" or any(os.environ.get(name) for name in screens):
            webbrowser.open(self.url)

    def wait(self) -> None:
        """Serve until Ctrl-C, then close the server."""
        try:
            while self._thread.is_alive():
                self._thread.join(0.5)
        except KeyboardInterrupt:
            pass
        finally:
            self.close()

    def close(self) -> None:
        """Stop serving and free the port."""
        if self._thread.is_alive():
            self._server.shutdown()
            self._thread.join()
        self._server.server_close()

    def __enter__(self) -> Player:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Player({self.url!r})"

    def _repr_html_(self) -> str:
        return inline_frame(self._server.content)


def check_port(port: int | None) -> None:
    """Raise the error that Player would raise for a port that cannot be used."""
    if port is not None:
        _listen(b"", port).server_close()


def _listen(content: bytes, port: int | None) -> _Server:
    if port is not None and (
        isinstance(port, bool) or not isinstance(port, Integral) or not 0 < port < 65536
    ):
        raise InputError(f"port must be a whole number from 1 to 65535, got {port!r}")
    try:
        return _Server(content, port or 0)
    except OSError as error:
        if port is not None and error.errno in (errno.EADDRINUSE, errno.EACCES):
            reason = "taken" if error.errno == errno.EADDRINUSE else "not permitted"
            raise InputError(
                f"port {port} is {reason}; choose another port, or none to use any free port"
            ) from None
        raise OutputError(f"cannot serve on {HOST}: {error.strerror}") from error


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    allow_reuse_address = True  # a recently closed port can be used again

    def __init__(self, content: bytes, port: int) -> None:
        self.content = content
        super().__init__((HOST, port), _Handler)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore browsers that close the connection."""


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    timeout = 30.0

    def do_GET(self) -> None:
        """Send the page."""
        self._answer(body=True)

    def do_HEAD(self) -> None:
        """Send the headers of the page."""
        self._answer(body=False)

    def _answer(self, *, body: bool) -> None:
        name = (self.headers.get("Host") or "").lower()
        port = self.server.server_port
        if name not in (f"{HOST}:{port}", f"localhost:{port}"):
            self.send_error(HTTPStatus.FORBIDDEN)
            return
        if self.path != "/":
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.send_header("Content-Length", str(len(self.server.content)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        if body:
            self.wfile.write(self.server.content)

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
        """Print nothing."""


def serve(
    content: bytes,
    words: str,
    *,
    port: int | None = None,
    show: bool = True,
    wait: bool | None = None,
) -> Player:
    """Serve a page and print its address.

    Args:
        content: The page.
        words: Text before the address.
        port: Port; an unused port if None.
        show: Open the user's browser.
        wait: Serve until Ctrl-C. If None, wait in scripts but not in interactive sessions.
    Returns:
        The server.
    """
    return run(Player(content, port), words, show=show, wait=wait)


def run(player: Player, words: str, *, show: bool, wait: bool | None) -> Player:
    """Print the address of a server, open the browser, and wait.

    Args:
        player: The server.
        words: Text before the address.
        show: Open the user's browser.
        wait: Serve until Ctrl-C. If None, wait in scripts but not in interactive sessions.
    Returns:
        The server.
    Raises:
        KeyboardInterrupt: Ctrl-C was pressed while the browser was opened, without waiting.
    """
    wait = not (hasattr(sys, "ps1") or is_notebook()) if wait is None else wait
    try:
        print(f"{words} {player.url}" + (" (Ctrl-C ends it)" if wait else ""), flush=True)
        if show and not is_notebook():  # A notebook shows the page in its cell.
            player.open()
        if wait:
            player.wait()
    except KeyboardInterrupt:
        player.close()
        if not wait:
            raise
    return player


def inline_frame(content: bytes) -> str:
    """Return an HTML element that shows a page in a notebook cell, without a server.

    Args:
        content: The page, in UTF-8.
    Returns:
        A resizable iframe.  The page in it has no access to the notebook.
    """
    page = escape(content.decode("utf-8"), quote=True)
    return (
        f'<div style="position:relative;resize:vertical;overflow:hidden;height:{_HEIGHT}px;'
        'min-height:240px">'
        f'<iframe sandbox="allow-scripts" title="pinred" srcdoc="{page}" '
        # marimo puts an element of its own between these two, so a height of 100 % has no effect.
        'style="position:absolute;top:0;left:0;width:100%;height:calc(100% - 8px);border:0">'
        "</iframe></div>"
    )


def is_notebook() -> bool:
    """Return whether the process is the kernel of a notebook, which displays results as HTML."""
    marimo = sys.modules.get("marimo")
    return in_notebook() or bool(getattr(marimo, "running_in_notebook", lambda: False)())
