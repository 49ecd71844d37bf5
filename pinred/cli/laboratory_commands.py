"""Commands of the laboratory: bench, stress, corpus and published."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..common.errors import InputError, OutputError
from ..common.files import write_table
from ..common.waiting import Wait
from .command_options import add_options, option_adder, out_path

if TYPE_CHECKING:
    from ..laboratory.bench.accuracy_record import WorkPrecision
    from ..laboratory.corpus.trial import Entry
    from ..laboratory.stress.check import Check


_FIGURE_ERROR = 1e-8  # error at which the fastest method of each tool is selected for the figure


def add_bench_arguments(sub: argparse.ArgumentParser) -> None:
    """Add a subcommand for each measurement."""
    commands = sub.add_subparsers(title="measurements", metavar="WHAT", required=True)

    def add(name: str, text: str, names: str = "", count: str = "") -> argparse.ArgumentParser:
        command: argparse.ArgumentParser = commands.add_parser(name, help=text, description=text)
        command.set_defaults(measurement=name)
        command.add_argument("--out", metavar="FOLDER", help="write the results there as csv")
        if names:
            text = f"names of {names} (default: {count})"
            command.add_argument(names, nargs="*", metavar=names[:-1].upper(), help=text)
        return command

    def add_members(command: argparse.ArgumentParser, count: int) -> None:
        text = f"number of trajectories (default: {count})"
        command.add_argument("--members", metavar="N", type=int, default=count, help=text)

    add("kernels", "time of one kernel evaluation against pin.aba", "robots", "a few")
    _add_accuracy_options(add("accuracy", "run time against error, also of other tools"))
    add("compare", "time of comparisons, and of one integration by ABA", "scenes", "all installed")
    add("first", "first calls with empty caches", "calls", "all")
    text = "trajectories per second of a batch, also with other tools"
    add_members(add("many", text, "scenes", "five"), 512)
    threads = add("threads", "time of simulate_many on one and two threads")
    threads.add_argument("robot", nargs="?", default="solo12", help="robot (default: solo12)")
    add_members(threads, 1000)


def run_bench(arguments: argparse.Namespace) -> int:
    """Run the measurement, print its result, and write it.  Returns 0."""
    folder = _make_folder(arguments.out)
    if arguments.measurement == "accuracy":
        return _run_accuracy(arguments, folder)
    from ..laboratory import bench

    names = ("robots", "robot", "scenes", "calls", "members")
    options = {name: value for name, value in vars(arguments).items() if name in names}
    name = "first_calls" if arguments.measurement == "first" else arguments.measurement
    with Wait(f"measures: {arguments.measurement}"):
        results = getattr(bench, f"bench_{name}")(**options, progress=True)
    tables = [results] if isinstance(results, bench.Table) else results
    print("\n\n".join(map(str, tables)))
    for file in dict.fromkeys(table.file for table in tables):
        _write(
            folder, file, [row for table in tables if table.file == file for row in table.records]
        )
    return 0


def _make_folder(path: str | None) -> Path | None:
    """Create the output folder before the measurement starts; raise OutputError if that fails."""
    if path is None:
        return None
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot create the folder '{path}': {error.strerror}") from error
    return folder


def _write(folder: Path | None, name: str, records: Sequence[dict[str, object]]) -> None:
    """Write records with equal keys to FOLDER/NAME.csv, if there is a folder."""
    if folder is None:
        return

    path = folder / f"{name}.csv"
    write_table(path, list(records[0]), records)
    print(f"written to {path}")


def _add_accuracy_options(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add = option_adder(sub)
    add("--scenes A,B,…", "names of scenes, or all (default: five of various size)")
    add("--methods A,B,…", "names of methods (default: all installed ones)")
    add("--tolerances T,…", "tolerances of the adaptive methods")
    add("--list", "list the scenes and methods, and stop")
    effort = sub.add_mutually_exclusive_group()
    effort.add_argument("--quick", action="store_true", help="rough measurement of one minute")
    effort.add_argument("--full", action="store_true", help="include slow methods; takes hours")


def _run_accuracy(arguments: argparse.Namespace, folder: Path | None) -> int:
    """Measure the results that the folder lacks; print and write all of them.  Returns 0."""
    from ..laboratory.bench.accuracy import (
        DEFAULT,
        FULL,
        QUICK,
        SOLVERS,
        continue_accuracy,
        solvers_named,
    )
    from ..laboratory.bench.accuracy_record import NAME
    from ..laboratory.bench.problems import SCENES, problems_named

    if arguments.list:
        print("scenes:", ", ".join(SCENES))
        print("methods:", ", ".join(method.name for method in SOLVERS))
        return 0
    effort = QUICK if arguments.quick else FULL if arguments.full else DEFAULT
    names = _split(arguments.scenes)
    if names == ["all"] or (names is None and arguments.full):
        names = list(SCENES)
    methods = solvers_named(_split(arguments.methods))
    problems, missing = problems_named(names)
    tolerances = _parse_tolerances(arguments.tolerances)
    results = continue_accuracy(problems, methods, tolerances, effort, folder)
    if folder is not None:
        _draw(folder, results)
        print(f"written to {folder / NAME}")
    for line in missing:
        print(line)
    return 0


def _draw(folder: Path, results: Sequence[WorkPrecision]) -> None:
    """Draw two figures for each result: all methods, and the fastest method of each tool."""
    from ..common.errors import MissingPackageError

    try:
        from ..views.plots import work_precision
        from .command_options import save_figure
    except MissingPackageError as error:
        print(f"no figures: {error}")
        return
    for k, result in enumerate(results):
        repetition = sum(before.problem == result.problem for before in results[:k])
        name = result.problem + (f"_{repetition + 1}" if repetition else "")
        fastest = result.only(result.fastest_of_tools(_FIGURE_ERROR))
        save_figure(work_precision(fastest), folder / f"{name}.png")
        save_figure(work_precision(result), folder / f"{name}_all.png")


def _split(text: str | None) -> list[str] | None:
    return None if text is None else [name.strip() for name in text.split(",") if name.strip()]


def _parse_tolerances(text: str | None) -> list[float] | None:
    if text is None:
        return None
    from ..common.arrays import positive

    tolerances = [positive(word, "a tolerance") for word in text.split(",")]  # type: ignore[arg-type]
    if not all(tolerance < 1.0 for tolerance in tolerances):
        raise InputError(f"tolerances must be below 1, got {text}")
    return tolerances


def add_stress_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add = option_adder(sub)
    add("--only A,B,…", "names of checks to run, with all their cases")
    add("--full", "include long runs: 1e6 periods, 1e7 steps, more frames")


def run_stress(arguments: argparse.Namespace) -> int:
    """Run the checks.  Returns 0, or 1 if a check fails."""
    from ..laboratory.bench.problems import select_named
    from ..laboratory.stress import CHECKS
    from ..laboratory.stress.check import Trial, run_check, table

    names = arguments.only.split(",") if arguments.only else ()
    checks = select_named(names, CHECKS, "check").values()
    trial = Trial(effort="full" if arguments.full else "usual")
    outcomes = []
    for check in checks:
        outcome = run_check(check, trial, _progress_of_stress)
        outcomes.append(outcome)
        if sys.stderr.isatty():
            sys.stderr.write("\r\033[K")
        verdict = "ok" if outcome.passed else "FAILED"
        print(f"{check.name}: {verdict}, {outcome.wall:.1f} s", file=sys.stderr)
        if arguments.only:
            print(f"{check.name}: {check.what}")
            for case in outcome.cases:
                print(f"  {case}")
    print(table(outcomes))
    return 0 if all(outcome.passed for outcome in outcomes) else 1


def _progress_of_stress(check: Check, count: int) -> None:
    """Show on a terminal how many cases of a check have run."""
    if sys.stderr.isatty():
        sys.stderr.write(f"\r\033[K{check.name}: {count} cases")
        sys.stderr.flush()


_DURATION = 0.5  # default duration of a motion [s]


def add_corpus_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    from ..scene.scene_options import SCENE_OPTIONS

    text = "folders with URDF, MJCF and SDF files"
    sub.add_argument("folders", nargs="*", metavar="FOLDER", help=text)
    add = option_adder(sub)
    add("--robots", "include the robots of `pinred robots`")
    add_options(sub, {"duration": replace(SCENE_OPTIONS["duration"], default=f"{_DURATION:g}")})
    sub.set_defaults(duration=_DURATION)
    add("--patience S", "time limit for each description [s]", float, 60.0)
    add("--out FILE", "write the table as csv")


def run_corpus(arguments: argparse.Namespace) -> int:
    """Process all descriptions and print a table.  Returns 1 for a failed comparison, else 0."""
    from ..laboratory.corpus.run_corpus import corpus

    path = out_path(arguments, (".csv",))
    result = corpus(
        arguments.folders,
        robots=arguments.robots,
        duration=arguments.duration,
        patience=arguments.patience,
        out=path,
        tried=_progress_of_corpus,
    )
    if sys.stderr.isatty():
        sys.stderr.write("\r\033[K")
    print(result)
    if path is not None:
        print(f"written to {path}")
    return 0 if result.passed else 1


def _progress_of_corpus(entry: Entry, number: int, of: int) -> None:
    """Show a progress line on a terminal, and a line for each failure everywhere."""
    if sys.stderr.isatty():
        sys.stderr.write(f"\r\033[K{number} of {of}: {entry.file[-60:]}")
        sys.stderr.flush()
    if entry.outcome in ("FAILED", "error"):
        start = "\r\033[K" if sys.stderr.isatty() else ""
        print(f"{start}{entry.outcome}: {entry.file}: {entry.reason}", file=sys.stderr)


def add_published_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    text = "rows to show in full, with their code (default: a table of all rows)"
    sub.add_argument("rows", nargs="*", metavar="ROW", help=text)
    option_adder(sub)("--list", "list the rows with their sources, and compute nothing")


def run_published(arguments: argparse.Namespace) -> int:
    """Compute the rows and print them.  Returns 0, or 1 if a row disagrees."""
    from ..laboratory.bench.problems import select_named
    from ..laboratory.published import ROWS
    from ..laboratory.published import row as published

    rows = select_named(arguments.rows, ROWS, "row").values()
    if arguments.list:
        for row in rows:
            print(f"{row.name:<22} {row.quantity}\n{'':<22} {row.source}")
        return 0
    results = []
    if not arguments.rows:
        print(published.heading())
    for row in rows:
        with Wait(f"computes the row {row.name}"):
            results.append(row.run())
        print((published.report if arguments.rows else published.line)(results[-1]))
        sys.stdout.flush()
    print(published.summary(results))
    return 0 if all(result.passed for result in results) else 1
