"""A progress bar for terminals and notebooks; silent elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from html import escape
from importlib import import_module
from types import TracebackType
from typing import Any, Protocol, TypeAlias, TypeVar

from .errors import InputError

Progress: TypeAlias = Callable[[float], None]
_T = TypeVar("_T")
_R = TypeVar("_R")

_WIDTH = 30
_EVERY = 0.1  # s between redraws
_PATIENCE = 0.5  # s before the first: short work shows nothing


class ProgressBar:
    """A bar that shows how much of some work is done, and disappears at the end."""

    def __init__(self, title: str) -> None:
        """Prepare a bar; nothing is drawn unless there is a notebook or a terminal."""
        self._title = title
        self._screen = _screen()
        self._next = time.monotonic() + _PATIENCE
        self._drawn = False

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._screen is not None and self._drawn:
            self._screen.clear()

    def __call__(self, part: float) -> None:
        """Show that `part`, from 0 to 1, is done."""
        if self._screen is None or time.monotonic() < self._next:
            return
        self._next, self._drawn = time.monotonic() + _EVERY, True
        self._screen.draw(self._title, part)


def shown(progress: Progress | bool | None, title: str) -> AbstractContextManager[Progress | None]:
    """Return a context that yields the function to call with the part done, or None.

    progress: True for a bar, None or False for nothing, or a function of one's own.
    Raises InputError for anything else.
    """
    if progress is True:
        return ProgressBar(title)
    if not (progress is None or progress is False or callable(progress)):
        raise InputError(f"progress must be True or a function of the part done, got {progress!r}")
    return nullcontext(progress if callable(progress) else None)


def one_by_one(
    items: Sequence[_T], measure: Callable[[_T], _R], progress: Progress | bool | None, title: str
) -> list[_R]:
    """Return what `measure` makes of each item, one after the other; progress as for `shown`."""
    found = []
    with shown(progress, title) as bar:
        done = bar or quiet
        for k, item in enumerate(items):
            found.append(measure(item))
            done((k + 1) / len(items))
    return found


def quiet(part: float) -> None:
    """Show nothing."""


class _Screen(Protocol):
    """A place where a bar is drawn."""

    def draw(self, title: str, part: float) -> None:
        """Draw the bar in the place of the one before."""

    def clear(self) -> None:
        """Remove the bar."""


def _screen() -> _Screen | None:
    # A notebook's kernel has imported IPython before anything of ours runs.
    ipython = sys.modules.get("IPython")
    if ipython is not None and hasattr(ipython.get_ipython(), "kernel"):
        return _Notebook()
    return _Terminal() if sys.stderr.isatty() else None


class _Terminal:
    """One line of standard error."""

    def draw(self, title: str, part: float) -> None:
        sys.stderr.write(f"\r\033[K{_line(title, part)}")
        sys.stderr.flush()

    def clear(self) -> None:
        sys.stderr.write("\r\033[K")
        sys.stderr.flush()


class _Notebook:
    """One output of the cell that is running, which is updated."""

    _handle: Any = None

    def draw(self, title: str, part: float) -> None:
        bar = f'<progress value="{part:.3f}" max="1"></progress>'
        html = f"<div>{escape(title)} {bar} {100 * part:.0f} %</div>"
        self._show({"text/plain": _line(title, part), "text/html": html})

    def clear(self) -> None:
        # An output cannot be taken back, and clearing the cell would take others' too.
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
