"""`pinred bench accuracy`: run time against error, written as it is measured, and resumed.

Nothing heavy is imported before the measurement runs.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..common.errors import InputError
from ..common.progress import ProgressBar

_LOOKED_AT = 1e-8  # error at which the fastest method of each tool is drawn

if TYPE_CHECKING:
    from ..laboratory.bench.accuracy import Effort
    from ..laboratory.bench.problems import Problem
    from ..laboratory.bench.solver import Solver
    from ..laboratory.bench.work_precision import WorkPrecision


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    sub.add_argument(
        "--scenes", metavar="A,B,…", help="by name, or all; five of different size if not given"
    )
    sub.add_argument("--methods", metavar="A,B,…", help="by name; all that are installed")
    sub.add_argument("--tolerances", metavar="T,…", help="of the methods that take one")
    sub.add_argument("--list", action="store_true", help="name the scenes and methods, and stop")
    effort = sub.add_mutually_exclusive_group()
    effort.add_argument("--quick", action="store_true", help="a first impression, in a minute")
    effort.add_argument("--full", action="store_true", help="what is slow, too; hours")


def run(options: argparse.Namespace, folder: Path | None) -> int:
    """Measure what is missing in the folder, print it, and write it."""
    from ..laboratory.bench.accuracy import DEFAULT, FULL, QUICK
    from ..laboratory.bench.scenes import SCENES, problems_named
    from ..laboratory.bench.solvers import ALL_SOLVERS, SOLVERS, solvers_named

    if options.list:
        print("scenes:", ", ".join(SCENES))
        print("methods:", ", ".join(method.name for method in SOLVERS))
        return 0
    effort = QUICK if options.quick else FULL if options.full else DEFAULT
    among = ALL_SOLVERS if options.full else SOLVERS
    names = _names(options.scenes)
    if names == ["all"] or (names is None and options.full):
        names = list(SCENES)
    methods = solvers_named(_names(options.methods), among)
    problems, missing = problems_named(names)
    _measure(problems, methods, _tolerances(options.tolerances), effort, folder)
    for line in missing:
        print(line)
    return 0


def _measure(
    problems: Sequence[Problem],
    methods: Sequence[Solver],
    tolerances: Sequence[float] | None,
    effort: Effort,
    folder: Path | None,
) -> None:
    from ..common.files import write_atomic
    from ..laboratory.bench.accuracy import YARDSTICK, bench_problem, run_name
    from ..laboratory.bench.overview import overview
    from ..laboratory.bench.record import NAME, read_record, write_record
    from ..laboratory.bench.solvers import solvers_named

    asked = effort.name
    if tolerances is not None:
        asked += f", tolerances {' '.join(f'{t:g}' for t in tolerances)}"
    path = None if folder is None else folder / NAME
    results = read_record(path, asked) if path is not None and path.exists() else []
    run = run_name()
    for k, problem in enumerate(problems):
        before = [found for found in results if found.problem == problem.name]
        done = {name for found in before for name in (*found.about, *found.missing)}
        wanted = [method for method in methods if method.name not in done]
        if not wanted:
            print(f"{problem.name} is measured already, in run {before[-1].run}\n")
            continue
        if before and YARDSTICK not in [method.name for method in wanted]:
            # Other runs are not to be compared with: this one measures pinred again.
            wanted = [*solvers_named([YARDSTICK]), *wanted]
        with ProgressBar(f"{problem.name} ({k + 1} of {len(problems)})") as bar:
            found = bench_problem(problem, wanted, tolerances, effort, run=run, progress=bar)
        print(found, end="\n\n", flush=True)
        results.append(found)
        if path is not None:
            write_record(path, asked, results)
    tables = overview(results)
    print(tables, end="\n\n")
    if path is not None and folder is not None:
        text = (tables + "\n").encode()
        write_atomic(folder / "overview.txt", lambda file: file.write(text))
        _write_equal_error(folder, results)
        _draw(folder, results)
        print(f"written to {path}")


def _draw(folder: Path, results: Sequence[WorkPrecision]) -> None:
    """Draw each result: all its methods, and the fastest of each tool."""
    from ..common.errors import MissingPackageError

    try:
        from ..views.plots import work_precision
        from .plot import save
    except MissingPackageError as error:
        print(f"no figures: {error}")
        return
    for k, found in enumerate(results):
        again = sum(before.problem == found.problem for before in results[:k])
        name = found.problem + (f"_{again + 1}" if again else "")
        few = found.only(found.fastest_of_tools(_LOOKED_AT))
        save(work_precision(few), folder / f"{name}.png")
        save(work_precision(found), folder / f"{name}_all.png")


def _write_equal_error(folder: Path, results: Sequence[WorkPrecision]) -> None:
    """Write times and ratios at equal error, which follow from the points."""
    from ..common.files import write_table
    from ..laboratory.bench.accuracy import YARDSTICK
    from ..laboratory.bench.work_precision import ERRORS

    columns = ["run", "problem", "error", "method", "wall", "times_pinred", "reference_error"]
    rows: list[dict[str, object]] = [
        {
            "run": found.run,
            "problem": found.problem,
            "error": error,
            "method": method,
            "wall": found.wall_at(method, error),
            "times_pinred": found.ratio_at(method, error) if YARDSTICK in found.about else "",
            "reference_error": found.reference_error,
        }
        for found in results
        for error in ERRORS
        for method in found.about
    ]
    write_table(folder / "equal_error.csv", columns, rows)


def _names(text: str | None) -> list[str] | None:
    return None if text is None else [name.strip() for name in text.split(",") if name.strip()]


def _tolerances(text: str | None) -> list[float] | None:
    if text is None:
        return None
    from ..common.arrays import positive

    found = [positive(word, "a tolerance") for word in text.split(",")]  # type: ignore[arg-type]
    if not all(tolerance < 1.0 for tolerance in found):
        raise InputError(f"tolerances are below 1, got {text}")
    return found
