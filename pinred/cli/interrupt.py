"""Ctrl-C on the command line: the process ends soon after the first, whatever is at work.

As a rule KeyboardInterrupt is raised and the command ends.  But libraries swallow it in their
callbacks, compilers do not look at signals, and threads are waited for; for these a thread
watches, and ends the process when its patience is over.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, NoReturn

_pressed, _said = threading.Event(), threading.Event()
CODE = 130  # as shells have it, 128 + SIGINT
_PATIENCE = 0.3  # s that a command has to end by itself, and to clean up


def say() -> None:
    """Tell, once, that the command was interrupted."""
    if not _said.is_set():
        _said.set()
        os.write(2, b"pinred: interrupted\n")


def pressed() -> bool:
    """Return whether Ctrl-C has been pressed, while `ends_soon` watches."""
    return _pressed.wait(0.05)


def end() -> NoReturn:
    """End the process here, with the children that it has, and wait for nothing.

    Python's own end would wait for threads, and for libraries to take themselves down.
    """
    if "multiprocessing" in sys.modules:
        for child in sys.modules["multiprocessing"].active_children():
            child.kill()
    say()
    os._exit(CODE)


@contextmanager
def ends_soon() -> Iterator[None]:
    """Let the process end with code 130 soon after the first Ctrl-C, if it has not by itself.

    It is for a process that does nothing else, from its main thread.
    """
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield  # somebody has said what Ctrl-C does, or that it does nothing, as `nohup` and `&` do
        return
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    threading.Thread(target=_watch, args=(reading,), daemon=True).start()
    sys.unraisablehook = partial(_swallowed, sys.unraisablehook)
    yield  # it goes on watching: the end of a process waits for threads


def _swallowed(told: Callable[[Any], object], found: sys.UnraisableHookArgs) -> None:
    """End the process where a callback of compiled code has nobody to raise Ctrl-C to."""
    if found.exc_type is KeyboardInterrupt:
        end()
    told(found)


def _watch(reading: int) -> None:
    while signal.SIGINT not in os.read(reading, 1):
        pass
    _pressed.set()
    threading.Event().wait(_PATIENCE)
    end()
