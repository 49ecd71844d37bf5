"""Capture of the lines that C++ libraries print on standard error.

A process has one standard error, so the output of other threads is captured, too.  Therefore
only one thread captures at a time, and all other output is printed at the end of the capture.  A
fork waits until the capture ends.
"""

from __future__ import annotations

import os
import re
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from threading import RLock

EVERYTHING = re.compile(rb".+", re.DOTALL)  # matches all output, as one text
_STDERR = 2
_LOCK = RLock()
os.register_at_fork(
    before=_LOCK.acquire, after_in_parent=_LOCK.release, after_in_child=_LOCK.release
)


@contextmanager
def library_output(own: re.Pattern[bytes]) -> Iterator[list[str]]:
    """Collect the output of a C++ library on standard error.

    Args:
        own: Pattern that matches the library's output.  All other output is printed at the end
            of the context.
    Yields:
        A list, to which the library's output is appended when the context ends.
    """
    texts: list[str] = []
    with _LOCK:
        if sys.stderr is not None:
            with suppress(OSError, ValueError):  # standard error is closed
                sys.stderr.flush()
        try:
            stderr = os.dup(_STDERR)
        except OSError:  # the process has no standard error
            yield texts
            return
        with tempfile.TemporaryFile() as file:
            os.dup2(file.fileno(), _STDERR)
            try:
                yield texts
            finally:
                os.dup2(stderr, _STDERR)
                os.close(stderr)
                file.seek(0)
                text = file.read()
                texts += [m[0].decode(errors="replace").strip() for m in own.finditer(text)]
                _print(own.sub(b"", text))


def _print(text: bytes) -> None:
    with suppress(OSError):
        while text:
            text = text[os.write(_STDERR, text) :]
