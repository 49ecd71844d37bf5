"""Corpus run: try all descriptions and build the table of outcomes.

A child process tries descriptions one by one; a failed process is replaced.

A file that crashes a parser or exceeds the time limit affects only its own row of the table.
"""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, fields
from multiprocessing.connection import Connection
from pathlib import Path
from xml.parsers import expat

import numpy as np

from ...common.errors import InputError, LoadError
from ...common.files import write_table
from ...system.find_robot_files import bundled_robots, example_robots
from .trial import GOOD, Description, Entry, Kind, Outcome, run_trial

_WARM_UP = 60.0  # additional time [s] of a new process for its imports


class Worker:
    """A process for trials, started on first use; it ends with the `with` block."""

    def __init__(self, duration: float, patience: float) -> None:
        """Store the duration of motions and the time limit of one description [s]."""
        self._duration, self._patience = duration, patience
        self._process: multiprocessing.process.BaseProcess | None = None
        self._pipe: Connection | None = None
        self._cache = tempfile.TemporaryDirectory(prefix="pinred-corpus-")

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self._stop()
        self._cache.cleanup()

    def run_trial(self, description: Description) -> Entry:
        """Try a description; the outcome is "stopped" after a timeout and "error" after a crash."""
        pipe, patience = self._ready()
        failure: tuple[Outcome, str, str]
        began = time.perf_counter()
        try:
            pipe.send(description)
            if pipe.poll(patience):
                entry: Entry = pipe.recv()
                return entry
            failure = "stopped", f"no answer in {self._patience:g} s", "time is up"
        except (EOFError, OSError):
            assert self._process is not None
            self._process.join(5.0)
            code = self._process.exitcode
            failure = "error", f"the process ended with code {code}", "crash"
        self._stop()
        outcome, reason, about = failure
        wall = time.perf_counter() - began
        return Entry(description.file, description.kind, outcome, reason, about, wall=wall)

    def _ready(self) -> tuple[Connection, float]:
        """Start a process if none is running; return its pipe, and the time limit for answers."""
        if self._pipe is not None:
            return self._pipe, self._patience
        # Threads and loaded libraries of the parent process do not survive a fork.
        context = multiprocessing.get_context("spawn")
        self._pipe, child_end = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(child_end, self._duration, self._cache.name), daemon=True
        )
        self._process.start()
        child_end.close()
        return self._pipe, self._patience + _WARM_UP

    def _stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._process.close()
        if self._pipe is not None:
            self._pipe.close()
        self._process = self._pipe = None


def _serve(pipe: Connection, duration: float, cache: str) -> None:
    """Try descriptions from a pipe until the pipe closes.  cache: folder for compiled kernels."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl-C
    os.environ["PINRED_CACHE_DIR"] = cache  # an empty cache, so that times include compilation
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # silence the parsers, which print to both streams
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    while True:
        try:
            description: Description = pipe.recv()
        except EOFError:
            return
        pipe.send(run_trial(description, duration))


_LONGEST = 1e6  # longest time limit that the operating system can wait for [s]
_WRITE_INTERVAL = 20  # number of entries between two updates of the csv file


@dataclass(frozen=True)
class SearchResult:
    """The descriptions in some folders.

    Attributes:
        descriptions: Complete robot descriptions.
        fragments: Number of files with parts of robots only, for other files to include.
        macros: Number of templates that xacro must expand.
        copies: Number of files with the same content as another file.
    """

    descriptions: tuple[Description, ...] = ()
    fragments: int = 0
    macros: int = 0
    copies: int = 0


@dataclass(frozen=True)
class Corpus:
    """The table of a corpus.

    Attributes:
        entries: One entry for each description, including fragments that only the trial detected.
        search: The descriptions, and the numbers of files that were left out.
    """

    entries: tuple[Entry, ...]
    search: SearchResult = SearchResult()

    @property
    def passed(self) -> bool:
        """Whether no description FAILED or raised an unexpected exception."""
        return all(entry.outcome not in ("FAILED", "error") for entry in self.entries)

    def __str__(self) -> str:
        return "\n\n".join(filter(None, (self.summary(), self.reasons(), self.slowest())))

    def summary(self) -> str:
        """Format the count of each outcome, and the success rate of files that should work."""
        kinds = [kind for kind in ("urdf", "mjcf", "sdf", "name") if self._of(kind)]
        rows = [f"{'':<38}" + "".join(f"{kind:>8}" for kind in kinds)]

        def row(what: str, count: Callable[[list[Entry]], object]) -> None:
            rows.append(f"{what:<38}" + "".join(f"{count(self._of(k))!s:>8}" for k in kinds))

        def outcome(name: str) -> Callable[[list[Entry]], int]:
            return lambda entries: sum(entry.outcome == name for entry in entries)

        row("tried", lambda entries: len(entries))
        for name in (*GOOD, "refused", "stopped", "FAILED", "error"):
            row(f"  {name}", outcome(name))
        row(
            "compared with MuJoCo's reading",
            lambda entries: sum(np.isfinite(e.mass) for e in entries),
        )
        row(
            "compared with another reader",
            lambda entries: sum(bool(e.reader) for e in entries),
        )
        row("should work (no names)", lambda entries: len(_due(entries)))
        row("  of these, good", lambda entries: _success_rate(_due(entries)))
        fragments = self.search.fragments + sum(e.outcome == "fragment" for e in self.entries)
        rows.append(
            f"left out: {self.search.copies} copies, {fragments} parts for others to include, and "
            f"{self.search.macros} templates for xacro"
        )
        return "\n".join(rows)

    def _of(self, kind: str) -> list[Entry]:
        return [e for e in self.entries if e.kind == kind and e.outcome != "fragment"]

    def reasons(self) -> str:
        """Format the reasons of failures by category, with one example for each category."""
        bad = [e for e in self.entries if not e.good and e.outcome != "fragment"]
        groups: dict[tuple[str, str], list[Entry]] = {}
        for entry in bad:
            groups.setdefault((entry.outcome, entry.about), []).append(entry)
        lines = []
        for (outcome, about), entries in sorted(groups.items(), key=lambda g: -len(g[1])):
            due = sum(entry.due for entry in entries)
            lines.append(f"{len(entries):>5} {outcome:<8} {about} (should work: {due})")
            shown = next((entry for entry in entries if entry.due), entries[0])
            lines.append(f"      {shown.file}: {shown.reason[:160]}")
        return "\n".join(lines)

    def slowest(self) -> str:
        """Format percentiles of the times for loading and for the first simulation."""
        lines = []
        for what in ("load", "simulate"):
            times = np.array([getattr(e, what) for e in self.entries])
            finite = times[np.isfinite(times)]
            if finite.size:
                half, most = np.percentile(finite, [50, 99])
                slow = self.entries[int(np.nanargmax(times))]
                lines.append(
                    f"{what}: half in {half:.2f} s, 99 % in {most:.2f} s, all in "
                    f"{finite.max():.2f} s ({slow.file}, {slow.joints} joints)"
                )
        return "\n".join(lines)


def corpus(
    folders: Iterable[str | Path] = (),
    *,
    robots: bool = False,
    duration: float = 0.5,
    patience: float = 60.0,
    out: Path | None = None,
    tried: Callable[[Entry, int, int], None] | None = None,
) -> Corpus:
    """Try all descriptions in some folders.

    Args:
        folders: Folders or files.
        robots: Also try all robots that can be loaded by name (listed by `pinred robots`).
        duration: Duration of the motions [s].
        patience: Time limit for one description [s].
        out: A csv file, updated regularly and at the end, also on interruption.
        tried: Called with each entry, its number, and the number of descriptions.
    Returns:
        The table of outcomes.
    Raises:
        InputError: There are no descriptions, or a limit is not positive.
        LoadError: A folder is missing.
        OutputError: `out` cannot be written.
    """
    if not (0.0 < duration < np.inf and 0.0 < patience <= _LONGEST):
        raise InputError(
            f"duration, patience: expected positive seconds, patience up to {_LONGEST:g}, "
            f"got {duration:g} and {patience:g}"
        )
    search = find_descriptions(folders)
    descriptions = list(search.descriptions)
    if robots:
        descriptions += [
            Description(name, "name") for name in (*bundled_robots(), *example_robots())
        ]
    if not descriptions:
        raise InputError("no URDF, MJCF or SDF files to try; name folders with some, or robots")
    entries: list[Entry] = []
    try:
        with Worker(duration, patience) as worker:
            for number, description in enumerate(descriptions, start=1):
                entries.append(worker.run_trial(description))
                if out is not None and number % _WRITE_INTERVAL == 0:
                    write_entries(out, entries)
                if tried is not None:
                    tried(entries[-1], number, len(descriptions))
    finally:
        if out is not None and entries:
            write_entries(out, entries)
    return Corpus(tuple(entries), search)


def _due(entries: list[Entry]) -> list[Entry]:
    return [entry for entry in entries if entry.due and entry.kind != "name"]


def _success_rate(entries: list[Entry]) -> str:
    counts = Counter(entry.good for entry in entries)
    return f"{100.0 * counts[True] / len(entries):.1f} %" if entries else "-"


def write_entries(path: Path, entries: Iterable[Entry]) -> None:
    """Write entries as csv; raise OutputError and keep the old file on failure."""
    columns = [field.name for field in fields(Entry)]
    write_table(path, columns, (vars(entry) for entry in entries))


_SUFFIXES = (".urdf", ".xml", ".mjcf", ".xacro", ".sdf", ".world", ".model")


_MOST_BYTES = 256_000_000


_KINDS: dict[str, Kind] = {"robot": "urdf", "mujoco": "mjcf", "sdf": "sdf"}


@dataclass(frozen=True)
class _Header:
    """Properties of an XML file that determine its kind.

    tag: root element.  xacro: whether the file needs xacro.  has_bodies: whether the file has links
    or bodies.  includes: other files that this file includes.
    """

    tag: str
    xacro: bool
    has_bodies: bool
    includes: tuple[Path, ...]


def find_descriptions(folders: Iterable[str | Path]) -> SearchResult:
    """Find all robot descriptions in folders (or files), sorted by path, without duplicates.

    Args:
        folders: Folders or files.
    Returns:
        The descriptions, and the numbers of files of all other kinds.
    Raises:
        LoadError: A folder is missing.
    """
    files = sorted({path for folder in folders for path in _files(Path(folder))})
    headers = {path: header for path in files if (header := _read_header(path)) is not None}
    included = {path.resolve() for header in headers.values() for path in header.includes}
    fragments = macros = copies = 0
    contents: set[str] = set()
    descriptions = []
    for path, header in headers.items():
        if header.tag == "mujocoinclude" or not header.has_bodies:
            fragments += 1
        elif header.xacro:
            macros += 1
        else:
            content = _content_hash(path, headers, set())
            copies += content in contents
            if content not in contents:
                contents.add(content)
                language = _KINDS[header.tag]
                descriptions.append(Description(str(path), language, path.resolve() in included))
    return SearchResult(tuple(descriptions), fragments, macros, copies)


def _files(folder: Path) -> Iterator[Path]:
    if folder.is_file():
        yield folder
        return
    if not folder.is_dir():
        raise LoadError(f"no such folder: {folder}")
    for path in folder.rglob("*"):
        if path.suffix.lower() in _SUFFIXES and path.is_file():
            yield path


def _read_header(path: Path) -> _Header | None:
    """Read the XML up to its first error; return None if it is neither URDF, MJCF nor SDF."""
    first: list[tuple[str, bool]] = []
    includes: list[Path] = []
    has_bodies = False

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal has_bodies
        if not first:
            first.append((tag, any(name.startswith("xmlns:xacro") for name in attributes)))
        has_bodies |= tag in ("link", "body", "replicate", "attach", "composite", "flexcomp")
        if tag == "include" and "file" in attributes:
            includes.append(path.parent / attributes["file"])
            has_bodies = True
        has_bodies |= first[0][0] == "sdf" and tag == "include"

    parser = expat.ParserCreate()
    parser.StartElementHandler = start
    with suppress(expat.ExpatError, ValueError, OSError):
        if path.stat().st_size <= _MOST_BYTES:
            parser.Parse(path.read_bytes().lstrip(), True)
    if not first or first[0][0] not in (*_KINDS, "mujocoinclude"):
        return None
    tag, declared = first[0]
    xacro = tag == "robot" and (path.suffix == ".xacro" or (declared and _has_macros(path)))
    return _Header(tag, xacro, has_bodies, tuple(includes))


def _has_macros(path: Path) -> bool:
    text = path.read_bytes()
    return b"<xacro:" in text or b"${" in text


def _content_hash(path: Path, headers: dict[Path, _Header], including: set[Path]) -> str:
    """Hash a file with the files it includes; `including`: chain of files that include it."""
    content = hashlib.sha256()
    with suppress(OSError):
        content.update(path.read_bytes())
    for other in headers[path].includes if path in headers else ():
        if other not in including:
            content.update(_content_hash(other, headers, including | {path}).encode())
    return content.hexdigest()
