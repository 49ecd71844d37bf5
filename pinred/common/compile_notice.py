"""One line about each compilation that takes longer than a second, for a user who waits for it."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Timer

from .progress import is_watched

_PATIENCE = 1.0  # time before the line is written [s]


@contextmanager
def notice_of_compiling(what: str) -> Iterator[None]:
    """Write one line if the body takes longer than a second; only on a terminal or in a notebook.

    Args:
        what: What is compiled, such as "the equations of 'solo12'".
    """
    if not is_watched():
        yield
        return
    line = f"pinred compiles {what}; the next process finds the result in its cache"
    timer = Timer(_PATIENCE, write_notice, [line])
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def write_notice(line: str) -> None:
    """Write one line on standard error."""
    # A progress bar may have left its text in the line of a terminal.
    start = "\r\033[K" if sys.stderr.isatty() else ""
    sys.stderr.write(f"{start}{line}\n")
    sys.stderr.flush()
