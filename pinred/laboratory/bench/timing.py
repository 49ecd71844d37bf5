"""Times that can be compared: medians of rounds in which what is measured takes turns."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from ...common.arrays import Array
from ...common.progress import Progress, quiet
from ...kernels.evaluate import repeat
from ...kernels.kernel import Kernel
from ...kernels.object_cache import ObjectCache

ROUNDS = 15  # of which the median counts
SPAN = 0.01  # s, at least, of one action in a round
LOADING = 20.0  # s, at most, that a first call may take to compile or load what it needs
FEWEST = 3  # rounds in which even a slow action takes part


class NoCache(ObjectCache):
    """A cache of kernels that keeps nothing, so that building is measured."""

    def get(self, key: str) -> None:
        """Find nothing."""

    def put(self, key: str, code: bytes) -> None:
        """Keep nothing."""


def alternating(
    actions: Sequence[Callable[[int], object]],
    *,
    rounds: int = ROUNDS,
    span: float | None = None,
    budget: float = np.inf,
    progress: Progress = quiet,
) -> Array:
    """Return seconds per call, (rounds, actions), the actions taking turns.

    actions: each does its work as often as it is told.  It is called once or twice before the clock
    runs, and then so often in each round that a round takes it at least `span` [s], SPAN
    if None.
    budget: s an action may take in all; a slow one sits out some of the rounds, though never
    so many that it has less than FEWEST, and its time there is NaN.
    """
    counts, turns = [], []
    span = SPAN if span is None else span
    for j, action in enumerate(actions):
        first, count = _seconds(action, 1), 1
        if span <= first < LOADING:
            first = _seconds(action, 1)
        while (last := _seconds(action, count) if first < span else first) < span:
            count *= 2
        counts.append(count)
        turns.append(int(min(rounds, max(FEWEST, budget / last))))
        progress((j + 1) / len(actions) / (rounds + 1))
    out = np.full((rounds, len(actions)), np.nan)
    for k in range(rounds):
        for j, (action, count) in enumerate(zip(actions, counts, strict=True)):
            if k * turns[j] // rounds < (k + 1) * turns[j] // rounds:
                out[k, j] = _seconds(action, count) / count
        progress((k + 2) / (rounds + 1))
    return out


def evaluations(kernel: Kernel) -> Callable[[int], None]:
    """Return what evaluates a kernel, at one random state, as often as it is told."""
    rng = np.random.default_rng(0)
    y = rng.normal(size=kernel.layout.size)
    parameters = rng.normal(size=kernel.layout.parameters)
    return lambda count: repeat(kernel.rate.address, parameters, y, count)


def repeated(action: Callable[[], object]) -> Callable[[int], None]:
    """Return what calls an action as often as it is told."""

    def several(count: int) -> None:
        for _ in range(count):
            action()

    return several


def _seconds(action: Callable[[int], object], count: int) -> float:
    began = time.perf_counter()
    action(count)
    return time.perf_counter() - began
