"""Objects that other threads compile before they are needed."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest

from pinred.common import machine_code, object_cache
from pinred.common.errors import CacheWarning
from pinred.common.object_cache import ObjectCache, cache_key

KEY = cache_key("ahead")


@pytest.fixture(autouse=True)
def two_processors(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Let one other thread compile, on machines with any number of processors."""
    monkeypatch.setattr(object_cache, "spare_processors", lambda: 1)
    yield
    object_cache.wait_for_workers()
    object_cache._ahead.clear()


def named(log: list[str], *codes: str) -> Callable[[], Sequence[Callable[[], bytes]]]:
    """Return a function that returns parts, which log the thread that compiles them."""

    def part(code: str) -> Callable[[], bytes]:
        def compile_part() -> bytes:
            log.append(threading.current_thread().name)
            return code.encode()

        return compile_part

    return lambda: [part(code) for code in codes]


def ended() -> None:
    """Wait until no other thread compiles."""
    object_cache.wait_for_workers()
    assert not object_cache._workers


def test_other_thread_compiles_and_stores_the_object(tmp_path: Path) -> None:
    """An object that is not requested is stored, so that it is compiled once per machine."""
    log: list[str] = []
    cache = ObjectCache(tmp_path)
    cache.compile_ahead(KEY, named(log, "one", "two"), b"-".join, "an object")
    ended()
    assert log == ["pinred compiles ahead"] * 2
    object_cache._ahead.clear()
    assert cache.get(KEY) == b"one-two"


def test_stored_object_is_not_compiled_again(tmp_path: Path) -> None:
    """With an entry in the cache, no parts are made and no thread starts."""
    cache = ObjectCache(tmp_path)
    cache.put(KEY, b"code")
    cache.compile_ahead(KEY, lambda: pytest.fail("divided"), b"".join, "an object")
    assert not object_cache._ahead
    assert cache.get(KEY) == b"code"


def test_nothing_is_compiled_ahead_with_one_processor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another thread would only take time from the caller."""
    monkeypatch.setattr(object_cache, "spare_processors", lambda: 0)
    cache = ObjectCache(tmp_path)
    cache.compile_ahead(KEY, lambda: pytest.fail("divided"), b"".join, "an object")
    assert cache.get(KEY) is None


def test_processors_of_the_process_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """A process may be limited to some processors of the machine."""
    monkeypatch.undo()
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3})
    assert machine_code.spare_processors() == 0
    monkeypatch.delattr(os, "sched_getaffinity")  # as on macOS
    monkeypatch.setattr(os, "cpu_count", lambda: 4)
    assert machine_code.spare_processors() == 3


def test_caller_compiles_the_parts_that_no_thread_has_begun(tmp_path: Path) -> None:
    """The caller waits only for the part that the other thread has begun, and stores the object."""
    log: list[str] = []
    begun, go = threading.Event(), threading.Event()

    def slow() -> bytes:
        begun.set()
        assert go.wait(10.0)
        return b"slow"

    def last() -> bytes:
        go.set()
        return b"last"

    cache = ObjectCache(tmp_path)
    parts = [slow, *named(log, "own")(), last]
    cache.compile_ahead(KEY, lambda: parts, b"-".join, "an object")
    assert begun.wait(10.0)
    assert cache.get(KEY) == b"slow-own-last"
    assert log == [threading.current_thread().name]
    ended()
    assert cache.get(KEY) == b"slow-own-last"


def test_caller_compiles_alone_after_a_failure_elsewhere(tmp_path: Path) -> None:
    """The error belongs to the caller, who meets it when it compiles the object itself."""

    def fail() -> bytes:
        raise ValueError("not compiled")

    cache = ObjectCache(tmp_path)
    cache.compile_ahead(KEY, lambda: [fail], b"".join, "an object")
    ended()
    assert cache.get(KEY) is None
    with pytest.raises(ValueError, match="not compiled"):
        cache.get_or_compile(KEY, fail, "an object")


def test_interrupted_caller_can_compile_again(tmp_path: Path) -> None:
    """Ctrl-C ends the wait; the next call compiles as if nothing had been done ahead."""

    def interrupt() -> bytes:
        raise KeyboardInterrupt

    cache = ObjectCache(tmp_path)
    ahead = object_cache.ObjectAhead([interrupt], b"".join, lambda _: True, "an object")
    object_cache._ahead[tmp_path, KEY] = ahead
    with pytest.raises(KeyboardInterrupt):
        cache.get(KEY)
    assert cache.get_or_compile(KEY, lambda: b"code", "an object") == b"code"


def test_caller_compiles_all_if_no_thread_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Python starts no threads while it ends, and limits may forbid them."""

    def refuse(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", refuse)
    log: list[str] = []
    cache = ObjectCache(tmp_path)
    cache.compile_ahead(KEY, named(log, "one"), b"".join, "an object")
    assert not object_cache._workers
    assert cache.get(KEY) == b"one"
    assert log == [threading.current_thread().name]
    object_cache._waiting.clear()


def test_only_the_caller_warns_of_a_cache_without_space(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Warnings of other threads would not belong to a line of the user's program."""

    def refuse(*_: object) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr(object_cache, "write_entry", refuse)
    cache = ObjectCache(tmp_path)
    cache.compile_ahead(KEY, named([], "one"), b"".join, "an object")
    ended()
    with pytest.warns(CacheWarning, match="is not stored") as warned:
        assert cache.get(KEY) == b"one"
    assert len(warned) == 1


def test_fork_waits_for_the_other_threads(tmp_path: Path) -> None:
    """A forked process has no thread that would release the locks of LLVM."""
    ends: list[float] = []

    def slow() -> bytes:
        time.sleep(0.3)
        ends.append(time.monotonic())
        return b"slow"

    cache = ObjectCache(tmp_path)
    cache.compile_ahead(KEY, lambda: [slow], b"".join, "an object")
    child = os.fork()
    if child == 0:
        os._exit(0 if ends else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
