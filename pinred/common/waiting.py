"""Lines on standard error that say what a user waits for.

On a terminal and in a notebook, a line appears after one second, and every ten seconds after it;
elsewhere, in a pipe or a file, every ten seconds.  The environment variable PINRED_QUIET, with any
value, turns them off.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from contextlib import ContextDecorator, suppress
from threading import Lock, Thread, get_ident

_PATIENCE = 1.0  # time before the first line for a user who watches [s]
_EVERY = 10.0  # time between lines [s]
_TICK = 0.1  # time between two looks at the open waits [s]
_IS_QUIET = "PINRED_QUIET" in os.environ
_IDLE = 20  # number of looks without an open wait after which the thread ends

_LOCK = Lock()
_open: dict[int, list[Wait]] = {}  # the open waits of each thread, inner ones last
_watcher: Thread | None = None
_last_line = -_EVERY  # time of the last line [s]


class Wait(ContextDecorator):
    """A context or a decorator of work that may take longer than a second.

    While waits are nested, the innermost one is stated.

    Attributes:
        began: Time at which the work began [s].
    """

    def __init__(self, what: str | Callable[[], str]) -> None:
        """Describe the work; nothing is written yet.

        Args:
            what: What pinred does, such as "compiles the equations of 'solo12'"; or a function
                that returns it, with the progress of the work.
        """
        self._what = what
        self.began = self._due = 0.0
        self._is_stated = False

    def _recreate_cm(self) -> Wait:
        """Return the wait of one call of a decorated function."""
        return Wait(self._what)

    def __enter__(self) -> Wait:
        global _watcher
        self.began = time.monotonic()
        self._due = self.began + _PATIENCE
        with _LOCK:
            _open.setdefault(get_ident(), []).append(self)
            if _watcher is None and not _IS_QUIET:
                _watcher = Thread(target=_watch, name="pinred-waits", daemon=True)
                _watcher.start()
        return self

    def __exit__(self, *_: object) -> None:
        with _LOCK:
            waits = _open.get(get_ident(), [])
            if self in waits:
                waits.remove(self)
            if not waits:
                _open.pop(get_ident(), None)

    def due_line(self, outermost: Wait) -> str:
        """Return the line that is due now, "" if none is.

        Args:
            outermost: The outermost wait of the thread, of which this one is the innermost.
        """
        global _last_line
        now = time.monotonic()
        # In a pipe, one wait after the other may be short, so the outermost one counts.
        due = self._due if is_watched() else max(outermost.began, _last_line) + _EVERY
        if now < due:
            return ""
        what = self._what if isinstance(self._what, str) else self._what()
        elapsed = f" ({now - self.began:.0f} s)" if self._is_stated else ""
        self._is_stated, self._due, _last_line = True, now + _EVERY, now
        return f"pinred {what}{elapsed}\n"


def say(text: str) -> None:
    """Write a line about work on standard error, unless PINRED_QUIET is set.

    Args:
        text: The line, without the name of the program.
    """
    if not _IS_QUIET:
        _write([f"pinred: {text}\n"])


def is_watched() -> bool:
    """Return whether messages appear on a terminal or in a notebook."""
    return in_notebook() or (sys.stderr is not None and sys.stderr.isatty())


def in_notebook() -> bool:
    """Return whether this process is the kernel of a notebook."""
    # A notebook kernel imports IPython before it runs any cell.
    ipython = sys.modules.get("IPython")
    return ipython is not None and hasattr(ipython.get_ipython(), "kernel")


def _watch() -> None:
    """Write lines about open waits until there are none for a while."""
    global _watcher
    idle = 0
    while True:
        time.sleep(_TICK)
        with _LOCK:
            idle = 0 if _open else idle + 1
            if idle > _IDLE:
                _watcher = None
                return
            lines = [line for waits in _open.values() if (line := waits[-1].due_line(waits[0]))]
        with suppress(OSError, ValueError):  # The reading process may have ended.
            _write(lines)


def _write(lines: list[str]) -> None:
    if not lines or sys.stderr is None:
        return
    # A progress bar may have left its text in the line of a terminal.
    start = "\r\033[K" if sys.stderr.isatty() else ""
    sys.stderr.write("".join(start + line for line in lines))
    sys.stderr.flush()


def _forget() -> None:
    """Forget the waits of the parent process, whose thread does not exist here."""
    global _watcher, _LOCK
    _LOCK, _watcher = Lock(), None
    _open.clear()


os.register_at_fork(after_in_child=_forget)
