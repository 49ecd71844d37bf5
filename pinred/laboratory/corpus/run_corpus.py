"""The table over a corpus, and how it is made."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...common.errors import InputError
from ...system.catalogue import bundled_robots, example_robots
from .corpus_entry import GOOD, Entry, write_entries
from .description_files import Description, Found, find_descriptions
from .trial import Wanted
from .worker import Worker

_EVERY = 20  # entries after which the file on disk is written anew


@dataclass(frozen=True)
class Corpus:
    """The table over a corpus.

    entries: one of each description.  fragments, macros, copies: files that are none (see
    `Found`); fragments that only trying showed are among the entries.
    """

    entries: tuple[Entry, ...]
    fragments: int = 0
    macros: int = 0
    copies: int = 0

    @property
    def passed(self) -> bool:
        """Whether nothing that was tried is wrong: no failed judgement, no defect."""
        return all(entry.outcome not in ("FAILED", "error") for entry in self.entries)

    def __str__(self) -> str:
        return "\n\n".join(filter(None, (self.summary(), self.reasons(), self.slowest())))

    def summary(self) -> str:
        """Return how many of each kind came to what, and the part of those that should work."""
        kinds = [kind for kind in ("urdf", "mjcf", "name") if self._of(kind)]
        rows = [f"{'':<38}" + "".join(f"{kind:>8}" for kind in kinds)]

        def row(what: str, count: Callable[[list[Entry]], object]) -> None:
            rows.append(f"{what:<38}" + "".join(f"{count(self._of(k))!s:>8}" for k in kinds))

        def outcome(name: str) -> Callable[[list[Entry]], int]:
            return lambda entries: sum(each.outcome == name for each in entries)

        row("tried", lambda entries: len(entries))
        for name in (*GOOD, "refused", "stopped", "FAILED", "error"):
            row(f"  {name}", outcome(name))
        row("compared with MuJoCo's reading", lambda entries: len(_compared(entries)))
        row("should work (no names)", lambda entries: len(_due(entries)))
        row("  of these, good", lambda entries: _part(_due(entries)))
        told = f"{self.copies} copies, {self._fragments} parts for others to include, and "
        rows.append(f"left out: {told}{self.macros} templates for xacro")
        return "\n".join(rows)

    @property
    def _fragments(self) -> int:
        return self.fragments + sum(each.outcome == "fragment" for each in self.entries)

    def _of(self, kind: str) -> list[Entry]:
        return [e for e in self.entries if e.kind == kind and e.outcome != "fragment"]

    def reasons(self) -> str:
        """Return why descriptions did not pass, by kind of reason, with an example each."""
        bad = [e for e in self.entries if not e.good and e.outcome != "fragment"]
        groups: dict[tuple[str, str], list[Entry]] = {}
        for entry in bad:
            groups.setdefault((entry.outcome, entry.about), []).append(entry)
        rows = []
        for (outcome, about), entries in sorted(groups.items(), key=lambda g: -len(g[1])):
            due = sum(entry.due for entry in entries)
            rows.append(f"{len(entries):>5} {outcome:<8} {about} (should work: {due})")
            shown = next((entry for entry in entries if entry.due), entries[0])
            rows.append(f"      {shown.file}: {shown.reason[:160]}")
        return "\n".join(rows)

    def slowest(self) -> str:
        """Return what loading and the first simulation take, and what the slowest 1 % do."""
        rows = []
        for what in ("load", "simulate"):
            times = np.array([getattr(e, what) for e in self.entries])
            there = times[np.isfinite(times)]
            if there.size:
                half, most = np.percentile(there, [50, 99])
                slow = self.entries[int(np.nanargmax(times))]
                rows.append(
                    f"{what}: half in {half:.2f} s, 99 % in {most:.2f} s, all in "
                    f"{there.max():.2f} s ({slow.file}, {slow.joints} joints)"
                )
        return "\n".join(rows)


def corpus(
    folders: Iterable[str | Path] = (),
    *,
    robots: bool = False,
    duration: float = 0.5,
    patience: float = 60.0,
    out: Path | None = None,
    tried: Callable[[Entry, int, int], None] | None = None,
) -> Corpus:
    """Return the table over all descriptions in some folders.

    robots: whether to try all robots that have names (`pinred robots`).  duration: of the
    motions [s].  patience: seconds that one description may take.  out: a csv file, written
    now and then and at the end, also when interrupted.  tried: called with each entry, its
    number and how many there are.
    Raises InputError if there is nothing to try, LoadError for a folder that is not there,
    OutputError.
    """
    if not (duration > 0.0 and patience > 0.0):
        raise InputError("duration and patience must be positive numbers of seconds")
    found = find_descriptions(folders)
    todo = list(found.descriptions)
    if robots:
        todo += [Description(name, "name") for name in (*bundled_robots(), *example_robots())]
    if not todo:
        raise InputError("no URDF or MJCF files to try; name folders with some, or robots")
    entries: list[Entry] = []
    try:
        with Worker(Wanted(duration), patience) as worker:
            for number, what in enumerate(todo, start=1):
                entries.append(worker.try_out(what))
                if out is not None and number % _EVERY == 0:
                    write_entries(out, entries)
                if tried is not None:
                    tried(entries[-1], number, len(todo))
    finally:
        if out is not None and entries:
            write_entries(out, entries)
    return _table(found, entries)


def _table(found: Found, entries: list[Entry]) -> Corpus:
    return Corpus(tuple(entries), found.fragments, found.macros, found.copies)


def _compared(entries: list[Entry]) -> list[Entry]:
    return [entry for entry in entries if np.isfinite(entry.mass)]


def _due(entries: list[Entry]) -> list[Entry]:
    return [entry for entry in entries if entry.due and entry.kind != "name"]


def _part(entries: list[Entry]) -> str:
    counts = Counter(entry.good for entry in entries)
    return f"{100.0 * counts[True] / len(entries):.1f} %" if entries else "-"
