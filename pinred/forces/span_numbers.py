"""The tables of a force model as data of runs: their segments at given times.

A kernel sees one segment of each table, as numbers that change from span to span.  It does not
depend on the number of entries of a table, and tables of one kind share it.
"""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from ..common.arrays import Array, read_only
from ..system.coordinates import Indices
from .signals.tabulated import Table


class SpanNumbers(ABC):
    """The numbers that change from span to span, of one run or of several runs.

    Attributes:
        size: Number of these numbers; the first one is the time `within` the span.
    """

    size: int

    @abstractmethod
    def at(self, within: Any, run: Indices | None = None) -> Array:
        """Return the numbers in spans.

        Args:
            within: A time in each span, (…) [s].
            run: Index of the run of each span, (…); None for one run, or for times whose first
                axis is that of all runs.
        Returns:
            The numbers, (…, size).
        """

    @abstractmethod
    def kinds(self, count: int) -> Indices:
        """Return a number for each of `count` runs, equal for runs with the same tables, (N,)."""

    @abstractmethod
    def __getitem__(self, runs: Any) -> SpanNumbers:
        """Return the numbers of the selected run or runs."""


class Tables(SpanNumbers):
    """The tables of one force model.

    Attributes:
        signals: The tables.
        starts: Index of the start of each table's segment among the numbers, (tables,).
        breaks: Sorted times at which a segment ends and the next begins, (B,) [s].
    """

    def __init__(self, signals: Sequence[Table] = ()) -> None:
        """Collect the segments; tables with equal times are looked up together."""
        self.signals = tuple(signals)
        widths = [table.width for table in signals]
        self.size = 1 + sum(widths)
        firsts = np.cumsum([1, *widths])
        groups: dict[bytes, list[int]] = {}
        for k, table in enumerate(signals):
            groups.setdefault(table.starts.tobytes(), []).append(k)
        self.starts = firsts[:-1]
        self._groups: list[tuple[Array, Indices | slice, Array]] = []
        for members in groups.values():
            columns = np.concatenate([np.arange(firsts[k], firsts[k + 1]) for k in members])
            rows = np.concatenate([signals[k].segments() for k in members], axis=1)
            where = slice(1, self.size) if len(groups) == 1 else columns
            self._groups.append((signals[members[0]].starts, where, rows))
        starts = [starts[1:] for starts, _, _ in self._groups]
        self.breaks = read_only(np.unique(np.concatenate(starts)) if starts else np.empty(0))

    def at(self, within: Any, run: Indices | None = None) -> Array:  # noqa: ARG002
        """Return the numbers in spans, (…, size); see SpanNumbers."""
        times = np.asarray(within, dtype=float)
        numbers = np.empty((*times.shape, self.size))
        numbers[..., 0] = times
        for starts, columns, rows in self._groups:
            # Before its first time, a table is extrapolated from its first segment.
            segment = np.maximum(np.searchsorted(starts, times, side="right") - 1, 0)
            numbers[..., columns] = rows[segment]
        return numbers

    def kinds(self, count: int) -> Indices:
        """Return zero for each of `count` runs, (N,)."""
        return np.zeros(count, dtype=np.intp)

    def __getitem__(self, runs: Any) -> Tables:
        return self

    @cached_property
    def digest(self) -> bytes:
        """Digest of all tables, equal for tables with equal segments."""
        digest = hashlib.sha256()
        for starts, columns, rows in self._groups:
            digest.update(repr((starts.shape, rows.shape)).encode())
            for array in (starts, np.arange(self.size)[columns], rows):
                digest.update(array.tobytes())
        return digest.digest()


class TablesOfRuns(SpanNumbers):
    """The tables of N runs of one kernel."""

    def __init__(self, tables: Sequence[Tables], which: Indices) -> None:
        """Store the tables.

        Args:
            tables: Distinct tables, each of the same size.
            which: Index of the tables of each run, (N,).
        """
        self._tables, self._which, self.size = tables, which, tables[0].size

    def at(self, within: Any, run: Indices | None = None) -> Array:
        """Return the numbers in spans, (…, size); see SpanNumbers."""
        times = np.asarray(within, dtype=float)
        if run is None:
            times = np.broadcast_to(times, (len(self._which), *times.shape[1:]))
            which = self._which
        else:
            which = self._which[run]
        numbers = np.empty((*times.shape, self.size))
        order = np.argsort(which, kind="stable")
        ends = np.searchsorted(which[order], np.arange(len(self._tables) + 1))
        for tables, first, last in zip(self._tables, ends[:-1], ends[1:], strict=True):
            rows = order[first:last]
            numbers[rows] = tables.at(times[rows])
        return numbers

    def kinds(self, count: int) -> Indices:  # noqa: ARG002
        """Return the index of the tables of each run, (N,)."""
        return self._which

    def __getitem__(self, runs: Any) -> SpanNumbers:
        which = self._which[runs]
        return self._tables[which] if np.ndim(which) == 0 else TablesOfRuns(self._tables, which)


def tables_of_runs(tables: Sequence[Tables]) -> SpanNumbers:
    """Return the tables of several runs, one Tables object each."""
    distinct = {id(each): each for each in tables}
    if len(distinct) == 1:
        return tables[0]
    index = {key: k for k, key in enumerate(distinct)}
    which = np.array([index[id(each)] for each in tables])
    return TablesOfRuns(tuple(distinct.values()), which)
