"""A progress bar for terminals and notebooks; elsewhere, a line every ten seconds."""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from html import escape
from importlib import import_module
from typing import Any, Protocol, TypeAlias, TypeVar

from .errors import InputError
from .waiting import Wait, in_notebook, is_watched

Progress: TypeAlias = Callable[[float], None]
_T = TypeVar("_T")
_R = TypeVar("_R")

_WIDTH = 30  # width of the bar [characters]
_EVERY = 0.1  # time between redraws [s]
_PATIENCE = 0.5  # time before the first draw [s], so that short work shows no bar
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
        self._next = self._began + _PATIENCE
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
        self._next, self._drawn = time.monotonic() + _EVERY, True
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
    minutes, remainder = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {remainder:02d} s" if minutes else f"{remainder} s"


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
