"""Tests of cached values."""

from __future__ import annotations

import time
from threading import Barrier, Thread

from pinred.common.memo import once_for_all


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
