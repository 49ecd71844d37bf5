"""Tests of cached values."""

from __future__ import annotations

import time
from threading import Barrier, Thread
from weakref import ref

from pinred.common.memo import once_for_all, recent


def test_once_for_all_in_parallel_threads_calls_once() -> None:
    """The function is called once for equal arguments, however many threads call it."""
    calls = []

    @once_for_all
    def make(number: int) -> object:
        calls.append(number)
        time.sleep(0.02)
        return object()

    results, start = [], Barrier(8)

    def ask() -> None:
        start.wait()
        results.append(make(1))

    threads = [Thread(target=ask) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert calls == [1]
    assert len({id(entry) for entry in results}) == 1
    assert make(2) is not results[0]


class Owner:
    """An object that stores values."""


class Value:
    """An object that can be referred to weakly."""


def test_recent_drops_the_least_recently_used() -> None:
    """A value that is used counts as recent, and kinds have separate limits."""
    owner, calls = Owner(), []

    def ask(key: int, kind: str = "a") -> Value:
        def make() -> Value:
            calls.append((kind, key))
            return Value()

        return recent(owner, key, make, 2, kind)

    first = ask(1)
    ask(2), ask(1), ask(3), ask(7, "b")
    assert ask(1) is first
    assert calls == [("a", 1), ("a", 2), ("a", 3), ("b", 7)]
    ask(2)
    assert calls[-1] == ("a", 2)


def test_recent_keeps_no_reference_to_dropped_values() -> None:
    """A dropped value is deleted with its last user."""
    owner = Owner()
    value = recent(owner, 1, Value, 1, "a")
    alive = ref(value)
    recent(owner, 2, Value, 1, "a")
    assert alive() is value
    del value
    assert alive() is None


def test_recent_in_parallel_threads_returns_one_value() -> None:
    """All threads get the value that was stored first."""
    owner, start, results = Owner(), Barrier(4), []

    def make() -> object:
        time.sleep(0.02)
        return object()

    def ask() -> None:
        start.wait()
        results.append(recent(owner, 1, make, 2, "a"))

    threads = [Thread(target=ask) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len({id(entry) for entry in results}) == 1
