"""Comparable timings: actions run alternately in several rounds; tables of results."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from string import Formatter
from typing import Any, ClassVar, TypeAlias

import numpy as np

from ...common.arrays import Array
from ...common.object_cache import ObjectCache
from ...common.waiting import Progress, quiet
from ...kernels.evaluate import repeat
from ...kernels.kernel import Kernel
from ...system.robot_files import has_example_robots

Tables: TypeAlias = dict[str, list[dict[str, object]]]  # name of a csv file → its rows
Action: TypeAlias = Callable[[int], object]  # repeats its work a given number of times

ROUNDS = 15  # default number of rounds; the median over rounds is reported
SPAN = 0.01  # least duration of an action in a round [s]; short actions are repeated
LOADING = 20.0  # a first call shorter than this [s] is repeated, because it may include compilation
FEWEST = 3  # least number of rounds of a slow action
BUNDLED, EXAMPLES = ("planar_chain5", "satellite_two_arms"), ("solo12", "talos")  # default robots


class TimingRow:
    """A row of a table of results, with the names and formats of its columns.

    Attributes:
        ROW: Format of the row; its fields are attributes of the result.
        TITLES: Titles of columns that differ from the attribute's name; a second line is the unit.
        FILE: Name of the csv file.
    """

    ROW: ClassVar[str]
    TITLES: ClassVar[Mapping[str, str]] = {}
    FILE: ClassVar[str]

    @classmethod
    def header(cls) -> str:
        """Return the header of the table."""
        lines = ["", ""]
        for before, name, spec, _ in Formatter().parse(cls.ROW):
            for k, title in enumerate(f"{cls.TITLES.get(name or '', name)}\n".split("\n")[:2]):
                lines[k] += f"{before}{title:{(spec or '').partition('.')[0]}}"
        return "\n".join(line.rstrip() for line in lines if line.strip())

    @classmethod
    def summary(cls, results: Any) -> list[str]:  # noqa: ARG003
        """Return the lines below the table."""
        return []

    def tables(self) -> Tables:
        """Return the rows of csv files."""
        return {self.FILE: [dict(vars(self))]}

    def __str__(self) -> str:
        names = [name for _, name, _, _ in Formatter().parse(self.ROW) if name]
        return self.ROW.format_map({name: getattr(self, name) for name in names})


def report(results: Sequence[object]) -> tuple[str, Tables]:
    """Return the text of results, and their rows in csv files.

    Args:
        results: Results of one kind, each with a method `tables`.
    Returns:
        The text, and the rows by the name of the file.
    """
    tables: Tables = {}
    for result in results:
        for name, rows in result.tables().items():  # type: ignore[attr-defined]
            tables.setdefault(name, []).extend(rows)
    if results and isinstance(first := results[0], TimingRow):
        below = first.summary(results)
        return "\n".join([first.header(), *map(str, results), *below]), tables
    return "\n\n".join(map(str, results)), tables


def robots_to_measure(
    names: Iterable[str], bundled: Sequence[str] = BUNDLED, examples: Sequence[str] = EXAMPLES
) -> list[str]:
    """Return the given names; by default, bundled robots and, if installed, examples."""
    return list(names) or [*bundled, *(examples if has_example_robots() else ())]


class NoCache(ObjectCache):
    """A kernel cache that stores nothing, so that compilation is measured."""

    def get(self, key: str) -> None:
        """Return None: nothing is cached."""

    def put(self, key: str, code: bytes) -> bool:  # noqa: ARG002
        """Discard the code, and return False."""
        return False


def alternating(
    actions: Sequence[Action],
    *,
    rounds: int = ROUNDS,
    span: float | None = None,
    budget: float = np.inf,
    clock: Callable[[], float] | None = None,
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
        clock: Function that returns the time [s]; time.perf_counter if None.
        progress: Called with the completed fraction.
    Returns:
        (rounds, actions) seconds per repetition; NaN in skipped rounds.
    """
    counts, numbers_of_rounds = [], []
    span = SPAN if span is None else span
    clock = time.perf_counter if clock is None else clock

    def measure(action: Action, count: int) -> float:
        began = clock()
        action(count)
        return clock() - began

    for j, action in enumerate(actions):
        first, count = measure(action, 1), 1
        if span <= first < LOADING:
            first = measure(action, 1)
        while (last := measure(action, count) if first < span else first) < span:
            count *= 2
        counts.append(count)
        numbers_of_rounds.append(int(min(rounds, max(FEWEST, budget / last))))
        progress((j + 1) / len(actions) / (rounds + 1))
    seconds = np.full((rounds, len(actions)), np.nan)
    for k in range(rounds):
        for j, (action, count) in enumerate(zip(actions, counts, strict=True)):
            n = numbers_of_rounds[j]
            if k * n // rounds < (k + 1) * n // rounds:  # select n evenly spread rounds
                seconds[k, j] = measure(action, count) / count
        progress((k + 2) / (rounds + 1))
    return seconds


def fastest(
    actions: Sequence[Action],
    *,
    rounds: int = ROUNDS,
    span: float | None = None,
    budget: float = np.inf,
) -> list[float]:
    """Return the least time of each of several actions [s]; see `alternating`."""
    times = alternating(actions, rounds=rounds, span=span, budget=budget)
    return [float(seconds) for seconds in np.nanmin(times, axis=0)]


def evaluations(kernel: Kernel) -> Action:
    """Return a function that evaluates a kernel at a random state a given number of times."""
    rng = np.random.default_rng(0)
    y = rng.normal(size=kernel.layout.size)
    parameters = rng.normal(size=kernel.layout.parameters)
    return lambda count: repeat(kernel.rate.address, parameters, y, count)


def repeated(action: Callable[[], object]) -> Action:
    """Return a function that calls an action a given number of times."""

    def repeat_action(count: int) -> None:
        for _ in range(count):
            action()

    return repeat_action
