"""Ctrl-C where compiled code calls Python back, and would swallow what is raised there."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def held_interrupt() -> Iterator[Callable[[], bool]]:
    """Yield what tells whether Ctrl-C has been pressed; it takes effect when the context ends.

    Then whoever handled it before does so, as a rule by raising KeyboardInterrupt.  Signals come
    to the main thread only; elsewhere, and where nobody of Python handles them, this does nothing.
    """
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield lambda: False
        return
    came: list[tuple[int, FrameType | None]] = []
    signal.signal(signal.SIGINT, lambda number, frame: came.append((number, frame)))
    try:
        yield lambda: bool(came)
    finally:
        signal.signal(signal.SIGINT, before)
        if came:
            before(*came[0])
