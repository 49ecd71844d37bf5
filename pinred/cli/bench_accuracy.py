"""`pinred bench accuracy`: measure run time against error, and continue interrupted runs."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..common.errors import InputError
from ..common.progress import ProgressBar
from .command_options import option_adder

_FIGURE_ERROR = 1e-8  # error at which the fastest method of each tool is selected for figures

if TYPE_CHECKING:
    from ..laboratory.bench.accuracy import Effort
    from ..laboratory.bench.problems import Problem
    from ..laboratory.bench.solver import Solver
    from ..laboratory.bench.work_precision import WorkPrecision


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add = option_adder(sub)
    add("--scenes A,B,…", "names of scenes, or all (default: five of various size)")
    add("--methods A,B,…", "names of methods (default: all installed ones)")
    add("--tolerances T,…", "tolerances of the adaptive methods")
    add("--list", "list the scenes and methods, and stop")
    effort = sub.add_mutually_exclusive_group()
    effort.add_argument("--quick", action="store_true", help="rough measurement of one minute")
    effort.add_argument("--full", action="store_true", help="include slow methods; takes hours")


def run(arguments: argparse.Namespace, folder: Path | None) -> int:
    """Measure the results that the folder does not have yet, print and write them.  Returns 0."""
    from ..laboratory.bench.accuracy import DEFAULT, FULL, QUICK
    from ..laboratory.bench.scenes import SCENES, problems_named
    from ..laboratory.bench.solvers import ALL_SOLVERS, SOLVERS, solvers_named

    if arguments.list:
        print("scenes:", ", ".join(SCENES))
        print("methods:", ", ".join(method.name for method in SOLVERS))
        return 0
    effort = QUICK if arguments.quick else FULL if arguments.full else DEFAULT
    solvers = ALL_SOLVERS if arguments.full else SOLVERS
    names = _split(arguments.scenes)
    if names == ["all"] or (names is None and arguments.full):
        names = list(SCENES)
    methods = solvers_named(_split(arguments.methods), solvers)
    problems, missing = problems_named(names)
    _measure(problems, methods, _parse_tolerances(arguments.tolerances), effort, folder)
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

    settings = effort.name
    if tolerances is not None:
        settings += f", tolerances {' '.join(f'{t:g}' for t in tolerances)}"
    path = None if folder is None else folder / NAME
    results = read_record(path, settings) if path is not None and path.exists() else []
    run = run_name()
    for k, problem in enumerate(problems):
        before = [result for result in results if result.problem == problem.name]
        measured = {name for result in before for name in (*result.about, *result.missing)}
        remaining = [method for method in methods if method.name not in measured]
        if not remaining:
            print(f"{problem.name} is measured already, in run {before[-1].run}\n")
            continue
        if before and YARDSTICK not in [method.name for method in remaining]:
            # Times of different runs are not comparable, so this run measures pinred again.
            remaining = [*solvers_named([YARDSTICK]), *remaining]
        with ProgressBar(f"{problem.name} ({k + 1} of {len(problems)})") as bar:
            result = bench_problem(problem, remaining, tolerances, effort, run=run, progress=bar)
        print(result, end="\n\n", flush=True)
        results.append(result)
        if path is not None:
            write_record(path, settings, results)
    tables = overview(results)
    print(tables, end="\n\n")
    if path is not None and folder is not None:
        text = (tables + "\n").encode()
        write_atomic(folder / "overview.txt", lambda file: file.write(text))
        _write_equal_error(folder, results)
        _draw(folder, results)
        print(f"written to {path}")


def _draw(folder: Path, results: Sequence[WorkPrecision]) -> None:
    """Draw two figures for each result: all methods, and the fastest method of each tool."""
    from ..common.errors import MissingPackageError

    try:
        from ..views.plots import work_precision
        from .output_files import save_figure
    except MissingPackageError as error:
        print(f"no figures: {error}")
        return
    for k, result in enumerate(results):
        repetition = sum(before.problem == result.problem for before in results[:k])
        name = result.problem + (f"_{repetition + 1}" if repetition else "")
        fastest = result.only(result.fastest_of_tools(_FIGURE_ERROR))
        save_figure(work_precision(fastest), folder / f"{name}.png")
        save_figure(work_precision(result), folder / f"{name}_all.png")


def _write_equal_error(folder: Path, results: Sequence[WorkPrecision]) -> None:
    """Write run times and their ratios at equal errors, interpolated between the points."""
    from ..common.files import write_table
    from ..laboratory.bench.accuracy import YARDSTICK
    from ..laboratory.bench.work_precision import ERRORS

    columns = ["run", "problem", "error", "method", "wall", "times_pinred", "reference_error"]
    records: list[dict[str, object]] = [
        {
            "run": result.run,
            "problem": result.problem,
            "error": error,
            "method": method,
            "wall": result.wall_at(method, error),
            "times_pinred": result.ratio_at(method, error) if YARDSTICK in result.about else "",
            "reference_error": result.reference_error,
        }
        for result in results
        for error in ERRORS
        for method in result.about
    ]
    write_table(folder / "equal_error.csv", columns, records)


def _split(text: str | None) -> list[str] | None:
    return None if text is None else [name.strip() for name in text.split(",") if name.strip()]


def _parse_tolerances(text: str | None) -> list[float] | None:
    if text is None:
        return None
    from ..common.arrays import positive

    tolerances = [positive(word, "a tolerance") for word in text.split(",")]  # type: ignore[arg-type]
    if not all(tolerance < 1.0 for tolerance in tolerances):
        raise InputError(f"tolerances are below 1, got {text}")
    return tolerances
