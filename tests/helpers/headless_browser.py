"""A headless Chromium controlled through two pipes, without opening a port.

Chromium uses its DevTools protocol over file descriptors 3 and 4, with messages terminated by a
zero byte (--remote-debugging-pipe).
"""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from pinred.common.errors import InputError, OutputError

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
_PATIENCE = 120.0  # time limit for an answer of the browser [s]; software rendering is slow
_FLAGS = (
    "--headless=new", "--remote-debugging-pipe", "--no-first-run", "--mute-audio",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--disable-default-apps", "--disable-extensions", "--disable-dev-shm-usage",
    "--hide-scrollbars", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--force-device-scale-factor=1",
)  # fmt: skip
# Program that moves the pipes to descriptors 3 and 4 and then executes the browser. A separate
# program is used because Python code between fork and exec is unsafe with threads.
_LAUNCHER = """
import fcntl, os, sys
source, sink = (fcntl.fcntl(int(n), fcntl.F_DUPFD, 5) for n in sys.argv[1:3])
os.dup2(source, 3)
os.dup2(sink, 4)
os.execv(sys.argv[3], sys.argv[3:])
"""


def find_browser() -> str:
    """Return the path of Chromium; raise InputError with instructions if it is not installed."""
    requested = os.environ.get("PINRED_BROWSER")
    for name in (requested,) if requested else NAMES:
        if path := shutil.which(name):
            return path
    if requested:
        raise InputError(
            f"PINRED_BROWSER is '{requested}', which does not exist; "
            "set it to the path of Chromium, or unset it"
        )
    raise InputError(
        "frames are rendered by Chromium, which was not found; install it "
        "(apt-get install chromium) or name it in the environment variable PINRED_BROWSER"
    )


class Browser:
    """One page in a headless Chromium.

    Attributes:
        events: DevTools events since the page was opened, in order, with `method` and `params`.
    """

    def __init__(self, process: subprocess.Popen[bytes], send: int, receive: int) -> None:
        """Open an empty page through the pipes of a browser process."""
        self._process, self._send, self._receive = process, send, receive
        self._unread, self._count = b"", 0
        self.events: list[dict[str, Any]] = []
        self._session: str | None = None
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Call a method of the DevTools protocol; raise OutputError if the browser rejects it."""
        self._count += 1
        message: dict[str, Any] = {"id": self._count, "method": method, "params": params}
        if self._session is not None:
            message["sessionId"] = self._session
        data = json.dumps(message).encode() + b"\0"
        while data:
            try:
                data = data[os.write(self._send, data) :]
            except OSError:
                raise OutputError("the browser has exited") from None
        for answer in self._messages():
            if answer.get("id") == self._count:
                if "error" in answer:
                    raise OutputError(f"the browser rejects {method}: {answer['error']['message']}")
                return dict(answer["result"])
        raise OutputError(f"the browser did not answer {method} within {_PATIENCE:g} s")

    def open(self, url: str, *, width: int, height: int) -> None:
        """Open a page with a window size [px] and wait until it is loaded."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width, height=height, deviceScaleFactor=1, mobile=False,
        )  # fmt: skip
        self.events.clear()
        failed = self.call("Page.navigate", url=url).get("errorText")
        if failed:
            raise OutputError(f"the browser cannot open {url}: {failed}")
        self.wait_for("document.readyState === 'complete'")

    def run(self, script: str) -> Any:
        """Return the value of a JavaScript expression; raise OutputError if it throws."""
        answer = self.call(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        if "exceptionDetails" in answer:
            raise OutputError(f"the page fails: {answer['exceptionDetails']['exception']}")
        return answer["result"].get("value")

    def wait_for(self, condition: str) -> None:
        """Wait until a JavaScript expression is true; raise OutputError after the time limit."""
        deadline = time.monotonic() + _PATIENCE
        while time.monotonic() < deadline:
            if self.run(condition):
                return
            time.sleep(0.02)
        raise OutputError(
            f"the condition '{condition}' was not true on the page within {_PATIENCE:g} s"
        )

    def screenshot(self) -> bytes:
        """Return a screenshot of the page as PNG."""
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])

    def _messages(self) -> Iterator[dict[str, Any]]:
        """Yield the answers of the browser; store its events in `events`."""
        deadline = time.monotonic() + _PATIENCE
        while True:
            while b"\0" in self._unread:
                text, self._unread = self._unread.split(b"\0", 1)
                message = json.loads(text)
                if "id" in message:
                    yield message
                else:
                    self.events.append(message)
            remaining = deadline - time.monotonic()
            if remaining <= 0.0 or not select.select([self._receive], [], [], remaining)[0]:
                return
            data = os.read(self._receive, 1 << 20)
            if not data:
                raise OutputError(f"the browser ended with code {self._process.wait()}")
            self._unread += data


@contextmanager
def browser() -> Iterator[Browser]:
    """Start a browser with a temporary profile; stop it and delete the profile after the block."""
    program = find_browser()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = [program, *_FLAGS, f"--user-data-dir={profile}"]
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            command.append("--no-sandbox")  # Chromium's sandbox does not work for root
        to_browser, send = os.pipe()
        receive, from_browser = os.pipe()
        with ExitStack() as closing:  # callbacks run in reverse order
            try:
                process = subprocess.Popen(
                    [sys.executable, "-c", _LAUNCHER, str(to_browser), str(from_browser), *command],
                    pass_fds=(to_browser, from_browser),
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                )
                closing.callback(_end, process)
            finally:
                os.close(to_browser)
                os.close(from_browser)
                closing.callback(os.close, send)  # closing the pipe ends the browser
                closing.callback(os.close, receive)
            yield Browser(process, send, receive)


def _end(process: subprocess.Popen[bytes]) -> None:
    """Wait until the browser exits after its pipe was closed; kill it after a time limit."""
    try:
        process.wait(10.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
