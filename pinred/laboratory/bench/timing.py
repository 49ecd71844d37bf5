"""Comparable timings: actions run alternately in several rounds."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from ...common.arrays import Array
from ...common.object_cache import ObjectCache
from ...common.progress import Progress, quiet
from ...kernels.evaluate import repeat
from ...kernels.kernel import Kernel

ROUNDS = 15  # default number of rounds; the median over rounds is reported
SPAN = 0.01  # least duration of an action in a round [s]; short actions are repeated
LOADING = 20.0  # a first call shorter than this [s] is repeated, because it may include compilation
FEWEST = 3  # least number of rounds of a slow action


class NoCache(ObjectCache):
    """A kernel cache that stores nothing, so that compilation is measured."""

    def get(self, key: str) -> None:
        """Return None: nothing is cached."""

    def put(self, key: str, code: bytes) -> bool:  # noqa: ARG002
        """Discard the code, and return False."""
        return False


def alternating(
    actions: Sequence[Callable[[int], object]],
    *,
    rounds: int = ROUNDS,
    span: float | None = None,
    budget: float = np.inf,
    progress: Progress = quiet,
) -> Array:
    """Time actions that run alternately.

    Args:
        actions: Functions that repeat their work a given number of times. Each is called once or
            twice before timing.
        rounds: Number of rounds.
        span: Least duration of an action in a round [s]; SPAN if None. The number of repetitions
            is chosen for it.
        budget: Time limit for an action over all rounds [s]. A slow action skips rounds, but is
            timed in at least FEWEST of them.
        progress: Called with the completed fraction.
    Returns:
        (rounds, actions) seconds per repetition; NaN in skipped rounds.
    """
    counts, numbers_of_rounds = [], []
    span = SPAN if span is None else span
    for j, action in enumerate(actions):
        first, count = _seconds(action, 1), 1
        if span <= first < LOADING:
            first = _seconds(action, 1)
        while (last := _seconds(action, count) if first < span else first) < span:
            count *= 2
        counts.append(count)
        numbers_of_rounds.append(int(min(rounds, max(FEWEST, budget / last))))
        progress((j + 1) / len(actions) / (rounds + 1))
    seconds = np.full((rounds, len(actions)), np.nan)
    for k in range(rounds):
        for j, (action, count) in enumerate(zip(actions, counts, strict=True)):
            n = numbers_of_rounds[j]
            if k * n // rounds < (k + 1) * n // rounds:  # select n evenly spread rounds
                seconds[k, j] = _seconds(action, count) / count
        progress((k + 2) / (rounds + 1))
    return seconds


def evaluations(kernel: Kernel) -> Callable[[int], None]:
    """Return a function that evaluates a kernel at a random state a given number of times."""
    rng = np.random.default_rng(0)
    y = rng.normal(size=kernel.layout.size)
    parameters = rng.normal(size=kernel.layout.parameters)
    return lambda count: repeat(kernel.rate.address, parameters, y, count)


def repeated(action: Callable[[], object]) -> Callable[[int], None]:
    """Return a function that calls an action a given number of times."""

    def repeat_action(count: int) -> None:
        for _ in range(count):
            action()

    return repeat_action


def _seconds(action: Callable[[int], object], count: int) -> float:
    began = time.perf_counter()
    action(count)
    return time.perf_counter() - began
