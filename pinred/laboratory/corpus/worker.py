"""A child process that tries one description after the other, and is replaced when it fails.

So a file that crashes a parser, or never ends, costs its own line and no other.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import tempfile
import time
from multiprocessing.connection import Connection
from types import TracebackType

from .corpus_entry import Entry
from .description_files import Description
from .trial import Wanted, tried

_WARM = 60.0  # s in which a new process may import what it needs, beside its first trial


class Worker:
    """A process for trials, started when it is first needed; ends with the `with` block."""

    def __init__(self, wanted: Wanted, patience: float) -> None:
        """Keep how to try, and the seconds that a description may take."""
        self._wanted, self._patience = wanted, patience
        self._process: multiprocessing.process.BaseProcess | None = None
        self._pipe: Connection | None = None
        self._cache = tempfile.TemporaryDirectory(prefix="pinred-corpus-")

    def __enter__(self) -> Worker:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stop()
        self._cache.cleanup()

    def try_out(self, what: Description) -> Entry:
        """Return what comes of a description; "stopped" if time is up, "error" for a crash."""
        pipe, patience = self._ready()
        began = time.perf_counter()
        try:
            pipe.send(what)
            if pipe.poll(patience):
                found: Entry = pipe.recv()
                return found
            outcome, reason, about = "stopped", f"no answer in {self._patience:g} s", "time is up"
        except (EOFError, OSError):
            assert self._process is not None
            self._process.join(5.0)
            code = self._process.exitcode
            outcome, reason, about = "error", f"the process ended with code {code}", "crash"
        self._stop()
        return Entry(
            what.file, what.kind, "error" if outcome == "error" else "stopped", reason, about,
            wall=time.perf_counter() - began,
        )  # fmt: skip

    def _ready(self) -> tuple[Connection, float]:
        """Return the pipe to a living process, and the seconds to wait for it."""
        if self._pipe is not None:
            return self._pipe, self._patience
        # Not forked: threads and open libraries of the parent do not survive that.
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(theirs, self._wanted, self._cache.name), daemon=True
        )
        self._process.start()
        theirs.close()
        return self._pipe, self._patience + _WARM

    def _stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._process.close()
        if self._pipe is not None:
            self._pipe.close()
        self._process = self._pipe = None


def _serve(pipe: Connection, wanted: Wanted, cache: str) -> None:
    """Try what comes through a pipe until it closes.  cache: a folder for kernels of its own."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent's to answer
    os.environ["PINRED_CACHE_DIR"] = cache  # times are those of the first use
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # parsers print as they like
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    while True:
        try:
            what: Description = pipe.recv()
        except EOFError:
            return
        pipe.send(tried(what, wanted))
