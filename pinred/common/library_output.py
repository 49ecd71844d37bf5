"""Lines that C++ libraries print on standard error, kept from it; all others come through.

Standard error is one for the whole process: while a library's lines are caught, those of other
threads are caught with them.  So one thread at a time catches, and gives back what is not the
library's as soon as it has finished.  A fork waits until then.
"""

from __future__ import annotations

import os
import re
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from threading import RLock

EVERYTHING = re.compile(rb".+", re.DOTALL)  # of what is printed, as one text
_STDERR = 2
_LOCK = RLock()
os.register_at_fork(
    before=_LOCK.acquire, after_in_parent=_LOCK.release, after_in_child=_LOCK.release
)


@contextmanager
def library_output(own: re.Pattern[bytes]) -> Iterator[list[str]]:
    """Collect what a library prints on standard error; its texts are there at the end.

    own: matches what the library prints.  What does not match is printed when this ends.
    """
    said: list[str] = []
    with _LOCK:
        if sys.stderr is not None:
            with suppress(OSError, ValueError):  # it is closed
                sys.stderr.flush()
        try:
            kept = os.dup(_STDERR)
        except OSError:  # there is no standard error
            yield said
            return
        with tempfile.TemporaryFile() as file:
            os.dup2(file.fileno(), _STDERR)
            try:
                yield said
            finally:
                os.dup2(kept, _STDERR)
                os.close(kept)
                file.seek(0)
                text = file.read()
                said += [found[0].decode(errors="replace").strip() for found in own.finditer(text)]
                _print(own.sub(b"", text))


def _print(text: bytes) -> None:
    with suppress(OSError):
        while text:
            text = text[os.write(_STDERR, text) :]
