"""Run time against error, recorded in a folder; a run continues the record of earlier runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ...common.files import write_atomic, write_table
from ...common.progress import ProgressBar
from .accuracy import YARDSTICK, Effort, bench_problem, run_name
from .overview import overview
from .problems import Problem
from .record import NAME, read_record, write_record
from .solver import Solver
from .solvers import solvers_named
from .work_precision import ERRORS, WorkPrecision


def continue_accuracy(
    problems: Sequence[Problem],
    methods: Sequence[Solver],
    tolerances: Sequence[float] | None,
    effort: Effort,
    folder: Path | None,
) -> list[WorkPrecision]:
    """Measure the results that a folder lacks; print and write all results.

    Args:
        problems: The scenes.
        methods: The methods.
        tolerances: Tolerances of the adaptive methods; by default those of each method.
        effort: Effort of the measurement.
        folder: Folder of the record and the tables; None to write nothing.
    Returns:
        The results, with the results of former runs in the folder.
    Raises:
        LoadError: The record of former runs cannot be read.
        InputError: The record was measured with other options.
    """
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
            result = bench_problem(
                problem,
                remaining,
                tolerances,
                effort,
                run=run,
                progress=bar,
            )
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
    return results


def _write_equal_error(folder: Path, results: Sequence[WorkPrecision]) -> None:
    """Write run times and their ratios at equal errors, interpolated between the points."""
    columns = [
        "run",
        "problem",
        "error",
        "method",
        "wall",
        "times_pinred",
        "reference_error",
    ]
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
