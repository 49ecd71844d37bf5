"""A progress bar for terminals; silent elsewhere."""

from __future__ import annotations

import sys
import time
from types import TracebackType

_WIDTH = 30
_EVERY = 0.1  # s between redraws
_PATIENCE = 0.5  # s before the first: short work shows nothing


class ProgressBar:
    """Draws the part of some work that is done on standard error while it runs."""

    def __init__(self, title: str) -> None:
        """Prepare a bar; nothing is drawn unless standard error is a terminal."""
        self._title = title
        self._next = time.monotonic() + _PATIENCE if sys.stderr.isatty() else float("inf")
        self._drawn = False

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._drawn:
            sys.stderr.write("\r\033[K")
            sys.stderr.flush()

    def __call__(self, part: float) -> None:
        """Show that `part`, from 0 to 1, is done."""
        now = time.monotonic()
        if now < self._next:
            return
        self._next, self._drawn = now + _EVERY, True
        full = round(_WIDTH * part)
        bar = "█" * full + "·" * (_WIDTH - full)
        sys.stderr.write(f"\r\033[K{self._title} {bar} {100 * part:3.0f} %")
        sys.stderr.flush()
