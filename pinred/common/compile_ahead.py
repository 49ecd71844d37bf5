"""Objects that other threads compile before they are needed, while this thread does other work.

An object is compiled in parts.  The thread that needs it compiles the parts that no other thread
has begun, so it never waits for a thread that has not started.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Sequence
from itertools import count
from threading import Event, Lock, Thread, current_thread

from .waiting import notice_of_compiling

Part = Callable[[], bytes]  # compiles one part


class ObjectAhead:
    """An object that several threads compile in parts.

    If another thread fails, there is no object.  The thread that needs it then compiles it alone,
    and raises the error.

    Attributes:
        is_stored: Whether another thread has stored the object.
    """

    def __init__(
        self,
        parts: Sequence[Part],
        join: Callable[[Sequence[bytes]], bytes],
        store: Callable[[bytes], bool],
        what: str,
    ) -> None:
        """Set the functions that compile the object, without calling them.

        Args:
            parts: Functions that each compile one part, the longest first.
            join: Returns the object of all parts.
            store: Stores an object that no thread has requested yet; returns whether it is stored.
            what: What the object is, for the notice of a user who waits.
        """
        self.is_stored = False
        self._parts, self._join, self._store, self._what = parts, join, store, what
        self._lock, self._next, self._ended = Lock(), count(), Event()
        self._codes: dict[int, bytes] = {}
        self._is_requested = self._has_failed = False

    def help(self) -> None:
        """Compile parts until all are begun; for other threads than the one that needs the object.

        Whoever compiles the last part of an object that is not requested yet stores it, so that
        code which is never needed is compiled once per machine.
        """
        try:
            is_last = self._compile_parts()
            if is_last and not self._is_requested:
                self.is_stored = self._store(self._joined())
        except Exception:
            self._has_failed = True
            self._ended.set()

    def result(self) -> bytes | None:
        """Compile the parts that no thread has begun, wait for the others, and return the object.

        Returns:
            The object, or None if another thread could not compile its part.
        """
        self._is_requested = True
        with notice_of_compiling(self._what):
            self._compile_parts()
            self._ended.wait()
        return None if self._has_failed else self._joined()

    def _compile_parts(self) -> bool:
        """Compile parts until all are begun; return whether the last one ended here."""
        is_last = False
        while (k := next(self._next)) < len(self._parts):
            code = self._parts[k]()
            with self._lock:
                self._codes[k] = code
                is_last = len(self._codes) == len(self._parts)
        if is_last:
            self._ended.set()
        return is_last

    def _joined(self) -> bytes:
        return self._join([self._codes[k] for k in range(len(self._codes))])


_LOCK = Lock()
_waiting: deque[ObjectAhead] = deque()
_workers: list[Thread] = []  # they end when no object is waiting


def spare_processors() -> int:
    """Return how many processors this process may use in addition to one."""
    return available_processors() - 1


def begin(ahead: ObjectAhead) -> None:
    """Let other threads compile an object, after those that are waiting already.

    Args:
        ahead: The object.
    """
    with _LOCK:
        _waiting.append(ahead)
        if len(_workers) >= spare_processors():
            return
        worker = Thread(target=_work, name="pinred compiles ahead")
        _workers.append(worker)
    try:
        worker.start()
    except RuntimeError:  # the process ends, or has too many threads
        with _LOCK:
            _workers.remove(worker)


def _work() -> None:
    """Compile objects until none is waiting."""
    while True:
        with _LOCK:
            if not _waiting:
                _workers.remove(current_thread())
                return
            ahead = _waiting[0]
        ahead.help()
        with _LOCK:
            if _waiting and _waiting[0] is ahead:
                _waiting.popleft()


def finish() -> None:
    """Wait until the other threads have ended."""
    for worker in tuple(_workers):
        worker.join()


# A forked process would have the locks that another thread holds, but not the thread.
os.register_at_fork(before=finish)


def available_processors() -> int:
    """Return the number of processors that this process may use, at least 1."""
    affinity = getattr(os, "sched_getaffinity", None)  # macOS has none
    return len(affinity(0)) if affinity is not None else os.cpu_count() or 1
