"""A progress bar for terminals and notebooks; nothing is drawn elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from html import escape
from importlib import import_module
from typing import Any, Protocol, TypeAlias, TypeVar

from .errors import InputError

Progress: TypeAlias = Callable[[float], None]
_T = TypeVar("_T")
_R = TypeVar("_R")

_WIDTH = 30  # width of the bar [characters]
_EVERY = 0.1  # time between redraws [s]
_PATIENCE = 0.5  # time before the first draw [s], so that short work shows no bar


class ProgressBar:
    """A progress bar that disappears when the work ends."""

    def __init__(self, title: str) -> None:
        """Prepare a bar, which is drawn only in terminals and notebooks."""
        self._title = title
        self._screen = _screen()
        self._next = time.monotonic() + _PATIENCE
        self._drawn = False

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(self, *_: object) -> None:
        if self._screen is not None and self._drawn:
            self._screen.clear()

    def __call__(self, part: float) -> None:
        """Show the completed fraction `part` of the work, from 0 to 1."""
        if self._screen is None or time.monotonic() < self._next:
            return
        self._next, self._drawn = time.monotonic() + _EVERY, True
        self._screen.draw(self._title, part)


def shown(progress: Progress | bool | None, title: str) -> AbstractContextManager[Progress | None]:
    """Return a context that yields the function to call with the completed fraction.

    Args:
        progress: True for a bar, None or False for no bar, or a function that is called with the
            completed fraction.
        title: Title of the bar.
    Returns:
        The context; it yields None if no progress is shown.
    Raises:
        InputError: `progress` has another type.
    """
    if progress is True:
        return ProgressBar(title)
    if not (progress is None or progress is False or callable(progress)):
        raise InputError(
            f"progress must be True or a function of the completed fraction, got {progress!r}"
        )
    return nullcontext(progress if callable(progress) else None)


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

    def draw(self, title: str, part: float) -> None:
        """Draw the bar over the previous one."""

    def clear(self) -> None:
        """Remove the bar."""


def _screen() -> _Screen | None:
    # A notebook kernel imports IPython before it runs any cell.
    ipython = sys.modules.get("IPython")
    if ipython is not None and hasattr(ipython.get_ipython(), "kernel"):
        return _Notebook()
    return _Terminal() if sys.stderr.isatty() else None


class _Terminal:
    """A bar in one line of standard error."""

    def draw(self, title: str, part: float) -> None:
        sys.stderr.write(f"\r\033[K{_line(title, part)}")
        sys.stderr.flush()

    def clear(self) -> None:
        sys.stderr.write("\r\033[K")
        sys.stderr.flush()


class _Notebook:
    """A bar in one output of the running notebook cell, updated in place."""

    _handle: Any = None

    def draw(self, title: str, part: float) -> None:
        bar = f'<progress value="{part:.3f}" max="1"></progress>'
        html = f"<div>{escape(title)} {bar} {100 * part:.0f} %</div>"
        self._show({"text/plain": _line(title, part), "text/html": html})

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
