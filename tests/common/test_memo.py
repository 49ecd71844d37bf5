"""Values that are made once."""

from __future__ import annotations

import time
from threading import Barrier, Thread

from pinred.common.memo import once_for_all


def test_threads_that_come_at_once_get_one_object() -> None:
    """The function is called once for the same arguments, however many ask."""
    calls = []

    @once_for_all
    def make(number: int) -> object:
        calls.append(number)
        time.sleep(0.02)
        return object()

    found, start = [], Barrier(8)

    def ask() -> None:
        start.wait()
        found.append(make(1))

    threads = [Thread(target=ask) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert calls == [1]
    assert len({id(entry) for entry in found}) == 1
    assert make(2) is not found[0]
