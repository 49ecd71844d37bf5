"""The harness of all measurements: actions that run alternately, and the table of results."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, TypeAlias, TypeVar

import numpy as np

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array
from ...common.waiting import Progress, quiet
from ...system.robot_files import has_example_robots

T = TypeVar("T")
Action: TypeAlias = Callable[[int], object]  # repeats its work a given number of times

ROUNDS = 15  # default number of rounds; the median over rounds is reported
SPAN = 0.01  # least duration of an action in a round [s]; short actions are repeated
LOADING = 20.0  # a first call shorter than this [s] is repeated, because it may include compilation
FEWEST = 3  # least number of rounds of a slow action


@checks_arguments
@dataclass(frozen=True)
class Table(Sequence[Any]):
    """Results of a measurement: a sequence of rows, which `str` formats.

    Attributes:
        file: Name of the csv file, without suffix.
        rows: The results. Their attributes are the columns of the table and of the csv file.
        units: Units of columns, by name.
        title: Line above the table.
        notes: Lines below the table.
        shared: Values that all rows share: further columns of the csv file.
    """

    file: str
    rows: tuple[SimpleNamespace, ...]
    units: Mapping[str, str] = field(default_factory=dict)
    title: str = ""
    notes: tuple[str, ...] = ()
    shared: Mapping[str, object] = field(default_factory=dict)

    @property
    def records(self) -> list[dict[str, object]]:
        """The rows of the csv file."""
        return [{**self.shared, **vars(row)} for row in self.rows]

    def __getitem__(self, index: Any) -> Any:
        """Return a row, or some rows."""
        return self.rows[index]

    def __len__(self) -> int:
        return len(self.rows)

    def __str__(self) -> str:
        columns: list[list[str]] = []
        for name in vars(self.rows[0]) if self.rows else ():
            values = [getattr(row, name) for row in self.rows]
            units = [f"[{self.units[name]}]" if name in self.units else ""] * bool(self.units)
            cells = [name, *units, *map(cell, values)]
            side, width = ">" if columns else "<", max(map(len, cells))
            columns.append([f"{cell:{side}{width}}" for cell in cells])
        lines = ["  ".join(cells).rstrip() for cells in zip(*columns, strict=True)]
        return "\n".join([*([self.title] if self.title else []), *lines, *self.notes])


def cell(value: Any) -> str:
    """Format a value with three digits, but numbers from 1000 on as whole numbers."""
    if not isinstance(value, float):
        return str(value)
    if np.isnan(value):
        return "—"
    return f"{value:.0f}" if 1e3 <= abs(value) < 1e7 else f"{value:.3g}"


def robots_to_measure(
    names: Iterable[str], bundled: Sequence[str], examples: Sequence[str]
) -> list[str]:
    """Return the given names; by default, bundled robots and, if installed, examples."""
    return list(names) or [*bundled, *(examples if has_example_robots() else ())]


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


def timed(action: Callable[[], T]) -> tuple[T, float]:
    """Call an action once; return its result and its wall time [s]."""
    began = time.perf_counter()
    result = action()
    return result, time.perf_counter() - began


def repeated(action: Callable[[], object]) -> Action:
    """Return a function that calls an action a given number of times."""

    def repeat_action(count: int) -> None:
        for _ in range(count):
            action()

    return repeat_action
