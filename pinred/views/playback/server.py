"""A server of one page for browsers on this machine only, and pages inside notebook cells.

meshcat's server listens on every interface. This server is bound to 127.0.0.1 and answers only
requests with that host name, so that a foreign site cannot redirect its host name to this server.
"""

from __future__ import annotations

import errno
import os
import sys
import threading
import webbrowser
from html import escape
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from numbers import Integral
from typing import Any

from ...common.errors import InputError, OutputError
from ...common.waiting import in_notebook

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
