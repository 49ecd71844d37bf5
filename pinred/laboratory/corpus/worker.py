"""A child process that tries descriptions one by one; a failed process is replaced.

A file that crashes a parser or exceeds the time limit affects only its own row of the table.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import tempfile
import time
from multiprocessing.connection import Connection

from .corpus_entry import Description, Entry, Outcome
from .trial import TrialOptions, run_trial

_WARM_UP = 60.0  # additional time [s] of a new process for its imports


class Worker:
    """A process for trials, started on first use; it ends with the `with` block."""

    def __init__(self, options: TrialOptions, patience: float) -> None:
        """Store the options of trials and the time limit of one description [s]."""
        self._options, self._patience = options, patience
        self._process: multiprocessing.process.BaseProcess | None = None
        self._pipe: Connection | None = None
        self._cache = tempfile.TemporaryDirectory(prefix="pinred-corpus-")

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self._stop()
        self._cache.cleanup()

    def run_trial(self, description: Description) -> Entry:
        """Try a description; the outcome is "stopped" after a timeout and "error" after a crash."""
        pipe, patience = self._ready()
        failure: tuple[Outcome, str, str]
        began = time.perf_counter()
        try:
            pipe.send(description)
            if pipe.poll(patience):
                entry: Entry = pipe.recv()
                return entry
            failure = "stopped", f"no answer in {self._patience:g} s", "time is up"
        except (EOFError, OSError):
            assert self._process is not None
            self._process.join(5.0)
            code = self._process.exitcode
            failure = "error", f"the process ended with code {code}", "crash"
        self._stop()
        outcome, reason, about = failure
        wall = time.perf_counter() - began
        return Entry(description.file, description.kind, outcome, reason, about, wall=wall)

    def _ready(self) -> tuple[Connection, float]:
        """Start a process if none is running; return its pipe, and the time limit for answers."""
        if self._pipe is not None:
            return self._pipe, self._patience
        # Threads and loaded libraries of the parent process do not survive a fork.
        context = multiprocessing.get_context("spawn")
        self._pipe, child_end = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(child_end, self._options, self._cache.name), daemon=True
        )
        self._process.start()
        child_end.close()
        return self._pipe, self._patience + _WARM_UP

    def _stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._process.close()
        if self._pipe is not None:
            self._pipe.close()
        self._process = self._pipe = None


def _serve(pipe: Connection, options: TrialOptions, cache: str) -> None:
    """Try descriptions from a pipe until the pipe closes.  cache: folder for compiled kernels."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl-C
    os.environ["PINRED_CACHE_DIR"] = cache  # an empty cache, so that times include compilation
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # silence the parsers, which print to both streams
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    while True:
        try:
            description: Description = pipe.recv()
        except EOFError:
            return
        pipe.send(run_trial(description, options))
