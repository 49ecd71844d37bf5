"""Ctrl-C on the command line: it ends the process within a fraction of a second.

Usually KeyboardInterrupt ends the command.  But libraries swallow it in their callbacks,
compilers ignore signals, and Python waits for threads at exit.  For these cases a thread waits
for the signal, and ends the process after a short grace period.
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

from ..common.interrupts import cleaning_up

_pressed, _reported = threading.Event(), threading.Event()
CODE = 130  # exit code of shells for a process that SIGINT ends: 128 + SIGINT
_PATIENCE = 0.3  # time limit for a command to clean up and end after Ctrl-C [s]


def say() -> None:
    """Print once, on standard error, that the command was interrupted."""
    if not _reported.is_set():
        _reported.set()
        os.write(2, b"pinred: interrupted\n")


def pressed() -> bool:
    """Return whether Ctrl-C has been pressed inside the context `ends_soon`."""
    return _pressed.wait(0.05)


def end() -> NoReturn:
    """End the process and its child processes immediately.

    The normal exit of Python would wait for threads and for the clean-up of libraries.
    """
    if "multiprocessing" in sys.modules:
        for child in sys.modules["multiprocessing"].active_children():
            child.kill()
    say()
    os._exit(CODE)


@contextmanager
def ends_soon() -> Iterator[None]:
    """End the process with code 130 soon after the first Ctrl-C, if it does not end normally.

    Use it in the main thread of a process that does nothing else.
    """
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield  # Another handler is installed, or SIGINT is ignored, as by `nohup` and `&`.
        return
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    threading.Thread(target=_watch, args=(reading,), daemon=True).start()
    sys.unraisablehook = partial(_end_if_swallowed, sys.unraisablehook)
    yield  # The thread keeps waiting, because other threads may delay the exit of the process.


def _end_if_swallowed(report: Callable[[Any], object], unraisable: sys.UnraisableHookArgs) -> None:
    """End the process if a callback of compiled code could not raise KeyboardInterrupt."""
    if unraisable.exc_type is KeyboardInterrupt:
        end()
    report(unraisable)


def _watch(reading: int) -> None:
    while signal.SIGINT not in os.read(reading, 1):
        pass
    _pressed.set()
    threading.Event().wait(_PATIENCE)
    with cleaning_up:
        end()
