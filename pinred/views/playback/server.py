"""Player: serves one page to browsers on this machine, and to nobody else.

meshcat's own server listens on every interface; this one is bound to 127.0.0.1, answers
only requests that were addressed to it by that name (a page elsewhere could otherwise point
a name of its own here), and knows one page.
"""

from __future__ import annotations

import errno
import os
import sys
import threading
import webbrowser
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from numbers import Integral
from types import TracebackType
from typing import Any

from ...common.errors import InputError, OutputError

HOST = "127.0.0.1"


class Player:
    """A page that is being served.  url: where; give it to a browser.

    Ends with close(), at the end of a `with` block, or with the process.
    """

    def __init__(self, content: bytes, port: int | None = None) -> None:
        """Serve an HTML page.

        port: where to listen, any free port if None.  Raises InputError for one that is
        taken or not allowed, OutputError if there is none.
        """
        self._server = _listen(content, port)
        self.url = f"http://{HOST}:{self._server.server_port}/"
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.1,), daemon=True)
        self._thread.start()

    def open(self) -> None:
        """Show the page in the user's browser, if there is a screen to show it on."""
        screens = ("DISPLAY", "WAYLAND_DISPLAY")
        if sys.platform != "linux" or any(os.environ.get(name) for name in screens):
            webbrowser.open(self.url)

    def wait(self) -> None:
        """Serve until Ctrl-C, then close."""
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

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Player({self.url!r})"


def check_port(port: int | None) -> None:
    """Raise what Player would raise if it were to listen at a port now."""
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
            why = "taken" if error.errno == errno.EADDRINUSE else "not open to you"
            raise InputError(
                f"port {port} is {why}; choose another, or none for any free one"
            ) from None
        raise OutputError(f"cannot serve on {HOST}: {error.strerror}") from error


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    allow_reuse_address = True  # a port that was just closed is free again

    def __init__(self, content: bytes, port: int) -> None:
        self.content = content
        super().__init__((HOST, port), _Handler)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Let a browser that hangs up do so quietly."""


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    timeout = 30.0

    def do_GET(self) -> None:
        """Answer with the page."""
        self._answer(body=True)

    def do_HEAD(self) -> None:
        """Answer with what goes before the page."""
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
        """Keep the terminal quiet."""
