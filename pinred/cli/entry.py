"""The entry point of the process `pinred`, which Ctrl-C ends within a fraction of a second.

Usually KeyboardInterrupt ends the command.  But libraries swallow it in their callbacks,
compilers ignore signals, and Python waits for threads at exit.  For these cases a thread waits
for the signal, and ends the process after a short grace period.

Ctrl-C ends start-up, too, so modules of pinred are imported inside the functions.
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

_pressed = threading.Event()
_PATIENCE = 0.3  # time limit for a command to clean up and end after Ctrl-C [s]


def main() -> int:
    """Run the command that the process's arguments name.  Returns its exit code."""
    try:
        from ..common.waiting import INTERRUPTED
        from .command_line import main as run

        with ends_soon():
            try:
                code = run()
            except Exception:
                if pressed():  # C extensions may replace KeyboardInterrupt by ImportError.
                    end()
                raise
        if code == INTERRUPTED:
            end()
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # The command has finished, so ignore Ctrl-C.
    except KeyboardInterrupt:  # Ctrl-C before the imports finished
        os.write(2, b"pinred: interrupted\n")
        os._exit(130)
    return code


def pressed() -> bool:
    """Return whether Ctrl-C has been pressed inside the context `ends_soon`."""
    return _pressed.wait(0.05)


def end() -> NoReturn:
    """End the process and its child processes immediately.

    The normal exit of Python would wait for threads and for the clean-up of libraries.
    """
    from ..common.waiting import INTERRUPTED, report_interrupt

    if "multiprocessing" in sys.modules:
        for child in sys.modules["multiprocessing"].active_children():
            child.kill()
    report_interrupt()
    os._exit(INTERRUPTED)


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
    from ..common.waiting import cleaning_up

    while signal.SIGINT not in os.read(reading, 1):
        pass
    _pressed.set()
    threading.Event().wait(_PATIENCE)
    with cleaning_up:
        end()
