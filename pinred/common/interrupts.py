"""Delay of Ctrl-C, because exceptions in callbacks of compiled code would be lost."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

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
