"""What a user sees while waiting, and Ctrl-C: lines on standard error, and progress bars.

On a terminal and in a notebook, a line appears after one second, and every ten seconds after it;
elsewhere, in a pipe or a file, every ten seconds.  The environment variable PINRED_QUIET, with any
value, turns them off.  Bars appear on terminals and in notebooks; elsewhere, lines replace them.

Exceptions in callbacks of compiled code would be lost, so `held_interrupt` delays Ctrl-C.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import (
    AbstractContextManager,
    ContextDecorator,
    contextmanager,
    nullcontext,
    suppress,
)
from html import escape
from importlib import import_module
from threading import Lock, Thread, get_ident
from types import FrameType
from typing import Any, Protocol, TypeAlias, TypeVar

from .errors import InputError

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


def notice_of_compiling(what: str) -> Wait:
    """Return the wait for a compilation.

    Args:
        what: What is compiled, such as "the equations of 'solo12'".
    """
    return Wait(f"compiles {what}; the next process finds the result in its cache")


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


Progress: TypeAlias = Callable[[float], None]
_T = TypeVar("_T")
_R = TypeVar("_R")

_WIDTH = 30  # width of the bar [characters]
_REDRAW = 0.1  # time between redraws [s]
_DRAW_AFTER = 0.5  # time before the first draw [s], so that short work shows no bar
_NOTICE_AFTER = 2.0  # time after which the remaining time is estimated [s]
_LONG_WORK = 20.0  # remaining time of which a notice warns [s]


class ProgressBar:
    """A progress bar that disappears when the work ends; without a screen, lines of a Wait."""

    def __init__(
        self, title: str, count: int = 0, unit: str = "", what: str = "", *, drawn: bool = True
    ) -> None:
        """Prepare a bar.

        Args:
            title: Title of the bar.
            count: Number of items; if stated, rate and remaining time are shown, too.
            unit: Name of the items, in the plural.
            what: What pinred does, for lines in place of a bar, such as "renders a film".
            drawn: Whether to draw the bar if there is a screen.
        """
        self._title, self._count, self._unit = title, count, unit
        self._what = what or f"continues: {title.strip()}"
        self._screen = _screen() if drawn else None
        self._began = time.monotonic()
        self._first: float | None = None  # fraction that was complete at the first call
        self._next = self._began + _DRAW_AFTER
        self._drawn = False
        self._part = 0.0
        self._wait = Wait(self._words)

    def _words(self) -> str:
        """Return the work, the completed percentage, the rate and the remaining time."""
        return f"{self._what}: {100 * self._part:.0f} %{self._pace(self._part)}"

    def __enter__(self) -> ProgressBar:
        if self._screen is None:
            self._wait.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        if self._screen is None:
            self._wait.__exit__()
        if self._screen is not None and self._drawn:
            self._screen.clear()

    def __call__(self, part: float) -> None:
        """Show the completed fraction `part` of the work, from 0 to 1."""
        if self._first is None:
            self._first = part
        self._part = part
        if self._screen is None or time.monotonic() < self._next:
            return
        self._next, self._drawn = time.monotonic() + _REDRAW, True
        self._screen.draw(self._title, part, self._pace(part))

    def _pace(self, part: float) -> str:
        """Return the rate and the remaining time in words; "" if they are unknown."""
        done = part - (self._first or 0.0)
        if not self._count or done <= 0.0:
            return ""
        elapsed = time.monotonic() - self._began
        remaining = elapsed * (1.0 - part) / done
        return f", {done * self._count / elapsed:.3g} {self._unit}/s, {_duration(remaining)} left"


def _duration(seconds: float) -> str:
    """Return a duration in words, such as "12 s" or "1 h 05 min"."""
    minutes, seconds_left = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {seconds_left:02d} s" if minutes else f"{seconds_left} s"


class LongRunNotice:
    """A progress function that warns once of the remaining time of long work."""

    def __init__(self, what: str, clock: Callable[[], float] = time.monotonic) -> None:
        """Start the clock.

        Args:
            what: The work and its size, as the beginning of a sentence.
            clock: Function that returns a time [s].
        """
        self._what, self._clock, self._began = what, clock, clock()
        self._is_open = True

    def __call__(self, part: float) -> None:
        """Warn if the rest of the work, of which the fraction `part` is complete, takes long."""
        elapsed = self._clock() - self._began
        if not self._is_open or part <= 0.0 or elapsed < _NOTICE_AFTER:
            return
        self._is_open = False
        remaining = elapsed * (1.0 - part) / part
        if remaining > _LONG_WORK:
            warnings.warn(
                f"{self._what}: {100.0 * part:.2g} % took {_duration(elapsed)}, and the rest takes "
                f"about {_duration(remaining)}. progress=True shows a bar.",
                stacklevel=2,
            )


def shown(
    progress: Progress | bool | None,
    title: str,
    count: int = 0,
    unit: str = "",
    what: str = "",
    *,
    reports: bool = False,
) -> AbstractContextManager[Progress | None]:
    """Return a context that yields the function to call with the completed fraction.

    Args:
        progress: True for a bar; None for a line about long work, see `waiting`; False for silence;
            or a function that is called with the completed fraction.
        title: Title of the bar.
        count: Number of items; if stated, the bar shows rate and remaining time, too.
        unit: Name of the items, in the plural.
        what: What pinred does, for lines in place of a bar.
        reports: Whether lines about long work state the completed fraction, which costs calls.
    Returns:
        The context; it yields None if nobody needs the completed fraction.
    Raises:
        InputError: `progress` has another type.
    """
    if progress is True:
        return ProgressBar(title, count, unit, what)
    if not (progress is None or progress is False or callable(progress)):
        raise InputError(
            f"progress must be True or a function of the completed fraction, got {progress!r}"
        )
    if progress is None and reports:
        return ProgressBar(title, count, unit, what, drawn=False)
    return _Lines(what) if progress is None and what else nullcontext(progress or None)


class _Lines(Wait):
    """Lines about long work that reports no progress."""

    def __enter__(self) -> None:  # type: ignore[override]
        super().__enter__()


def one_by_one(
    items: Sequence[_T], measure: Callable[[_T], _R], progress: Progress | bool | None, title: str
) -> list[_R]:
    """Apply a function to each item and show the progress.

    Args:
        items: The items.
        measure: Function that is applied to each item.
        progress: See `shown`.
        title: Title of the bar.
    Returns:
        The results, in the order of the items.
    """
    results = []
    with shown(progress, title) as bar:
        done = bar or quiet
        for k, item in enumerate(items):
            results.append(measure(item))
            done((k + 1) / len(items))
    return results


def quiet(part: float) -> None:
    """Ignore the completed fraction: a progress function that shows nothing."""


class _Screen(Protocol):
    """An output device that can draw a bar."""

    def draw(self, title: str, part: float, pace: str) -> None:
        """Draw the bar over the previous one, with rate and remaining time in words."""

    def clear(self) -> None:
        """Remove the bar."""


def _screen() -> _Screen | None:
    if not is_watched():
        return None
    return _Notebook() if in_notebook() else _Terminal()


class _Terminal:
    """A bar in one line of standard error."""

    def draw(self, title: str, part: float, pace: str) -> None:
        sys.stderr.write(f"\r\033[K{_line(title, part)}{pace}")
        sys.stderr.flush()

    def clear(self) -> None:
        sys.stderr.write("\r\033[K")
        sys.stderr.flush()


class _Notebook:
    """A bar in one output of the running notebook cell, updated in place."""

    _handle: Any = None

    def draw(self, title: str, part: float, pace: str) -> None:
        bar = f'<progress value="{part:.3f}" max="1"></progress>'
        html = f"<div>{escape(title)} {bar} {100 * part:.0f} %{escape(pace)}</div>"
        self._show({"text/plain": _line(title, part) + pace, "text/html": html})

    def clear(self) -> None:
        # A single output cannot be removed, so make it empty instead.
        self._show({"text/plain": "", "text/html": ""})

    def _show(self, bundle: dict[str, str]) -> None:
        if self._handle is None:
            display = import_module("IPython.display").display
            self._handle = display(bundle, raw=True, display_id=True)
        else:
            self._handle.update(bundle, raw=True)


def _line(title: str, part: float) -> str:
    full = round(_WIDTH * part)
    return f"{title} {'█' * full}{'·' * (_WIDTH - full)} {100 * part:3.0f} %"


INTERRUPTED = 130  # exit code of shells for a process that SIGINT ends: 128 + SIGINT
_reported = threading.Event()


def report_interrupt() -> None:
    """Print once, on standard error, that a command was interrupted."""
    if not _reported.is_set():
        _reported.set()
        os.write(2, b"pinred: interrupted\n")


# Held while a file is written that must be complete before an interrupted process ends.
cleaning_up = threading.RLock()


@contextmanager
def held_interrupt() -> Iterator[Callable[[], bool]]:
    """Delay Ctrl-C until the end of the context.

    At the end, the previous handler runs; usually it raises KeyboardInterrupt.  Python receives
    signals only in the main thread.  In other threads, or without a Python handler, Ctrl-C is not
    delayed.

    Yields:
        A function that returns whether Ctrl-C was pressed.
    """
    previous = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(previous):
        yield lambda: False
        return
    signals: list[tuple[int, FrameType | None]] = []
    signal.signal(signal.SIGINT, lambda number, frame: signals.append((number, frame)))
    try:
        yield lambda: bool(signals)
    finally:
        signal.signal(signal.SIGINT, previous)
        if signals:
            previous(*signals[0])
