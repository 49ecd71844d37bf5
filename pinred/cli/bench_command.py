"""`pinred bench`: run a measurement, print its result, and write it as csv.

Modules that need much memory or time to import are imported by the measurement that needs them.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from ..common.errors import InputError, OutputError
from ..common.progress import ProgressBar
from .command_options import option_adder

Records: TypeAlias = Sequence[dict[str, object]]
Result: TypeAlias = tuple[str, Mapping[str, Records]]  # text to print, and {csv name: records}
Measurement: TypeAlias = Callable[[argparse.Namespace], Result]

_FIGURE_ERROR = 1e-8  # error at which the fastest method of each tool is selected for figures


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add a subcommand for each measurement."""
    commands = sub.add_subparsers(title="measurements", metavar="WHAT", required=True)

    def add(
        name: str, measure: Measurement | None, text: str, names: str = "", count: str = ""
    ) -> argparse.ArgumentParser:
        command: argparse.ArgumentParser = commands.add_parser(name, help=text, description=text)
        command.set_defaults(measure=measure)
        command.add_argument("--out", metavar="FOLDER", help="write the results there as csv")
        if names:
            text = f"names of {names} (default: {count})"
            command.add_argument(names, nargs="*", metavar=names[:-1].upper(), help=text)
        return command

    def add_members(command: argparse.ArgumentParser, count: int) -> None:
        text = f"number of trajectories (default: {count})"
        command.add_argument("--members", metavar="N", type=int, default=count, help=text)

    add("kernels", _kernels, "time of one kernel evaluation against pin.aba", "robots", "a few")
    add("forces", _forces, "kernels with forces that observe the base", "robots", "four")
    _add_accuracy_options(add("accuracy", None, "run time against error, also of other tools"))
    text = "evaluations that an accuracy costs, for many methods"
    add("evaluations", _evaluations, text, "scenes", "four")
    add("flow", _flow, "calls, gradients, and variable inertias of flows", "robots", "four")
    add("scaling", _scaling, "one kernel evaluation for chains of 5 to 100 joints")
    add("floquet", _floquet, "Floquet multipliers by three routes against a closed form")
    text = "trajectories per second of a batch, also with other tools"
    add_members(add("many", _many, text, "scenes", "five"), 512)
    threads = add("threads", _threads, "time and memory of simulate_many on one and two threads")
    threads.add_argument("robot", nargs="?", default="solo12", help="robot (default: solo12)")
    add_members(threads, 1000)


def run(arguments: argparse.Namespace) -> int:
    """Run the measurement, print its result, and write it.  Returns 0."""
    folder = _make_folder(arguments.out)
    if arguments.measure is None:
        return _run_accuracy(arguments, folder)
    text, tables = arguments.measure(arguments)
    print(text)
    for name, records in tables.items():
        _write(folder, name, records)
    return 0


def _columns(result: Any, names: Iterable[str]) -> dict[str, object]:
    return {name: getattr(result, name) for name in names}


def _entries(result: Any, names: Iterable[str], k: int) -> dict[str, object]:
    return {name: getattr(result, name)[k] for name in names}


def _table(header: str, timings: Iterable[object]) -> str:
    return "\n".join([header, *map(str, timings)])


def _blocks(results: Iterable[object]) -> str:
    return "\n\n".join(map(str, results))


def _kernels(arguments: argparse.Namespace) -> Result:
    from ..laboratory.bench.kernel_timing import KernelTiming, bench_kernels

    timings = bench_kernels(arguments.robots, progress=True)
    records = [{**vars(timing), "ratio": timing.ratio} for timing in timings]
    return _table(KernelTiming.header(), timings), {"kernels": records}


def _forces(arguments: argparse.Namespace) -> Result:
    from ..laboratory.bench.force_timing import ForcesTiming, bench_forces

    timings = bench_forces(arguments.robots, progress=True)
    names = ("robot", "free", "torque", "wrench", "full")
    records = [_columns(timing, names) for timing in timings]
    return _table(ForcesTiming.header(), timings), {"forces": records}


def _evaluations(arguments: argparse.Namespace) -> Result:
    from ..laboratory.bench.evaluations import ERRORS, FEW_SCENES, bench_evaluations

    results = bench_evaluations(arguments.scenes or FEW_SCENES, progress=True)
    records: Records = [
        {"problem": result.problem, "method": name, "error": error, "evaluations": count}
        for result in results
        for name, counts in result.counts.items()
        for error, count in zip(ERRORS, counts, strict=True)
    ]
    return _blocks(results), {"evaluations": records}


def _flow(arguments: argparse.Namespace) -> Result:
    from ..laboratory.bench.flow_timing import FlowTiming, bench_flow

    timings = bench_flow(arguments.robots, progress=True)
    records = [dict(vars(timing)) for timing in timings]
    return _table(FlowTiming.header(), timings), {"flow": records}


def _scaling(_: argparse.Namespace) -> Result:
    from ..laboratory.bench.scaling import bench_scaling

    results = bench_scaling(progress=True)
    names = ("joints", "instructions", "build", "kernel")
    records = [
        {"family": result.family, **_entries(result, names, k)}
        for result in results
        for k in range(len(result.joints))
    ]
    return _blocks(results), {"scaling": records}


def _floquet(_: argparse.Namespace) -> Result:
    from ..laboratory.bench.floquet_timing import ROUTES, bench_floquet

    results = bench_floquet(progress=True)
    records: Records = [
        {"robot": result.robot, "route": name, "wall": wall, "error": error}
        for result in results
        for name, wall, error in zip(ROUTES, result.wall, result.error, strict=True)
    ]
    return _blocks(results), {"floquet": records}


def _many(arguments: argparse.Namespace) -> Result:
    from ..laboratory.bench.batch_timing import bench_many

    results = bench_many(arguments.scenes or None, members=arguments.members, progress=True)
    records: Records = [
        {"problem": result.problem, "members": result.members, **vars(rate)}
        for result in results
        for rate in result.rates
    ]
    return _blocks(results), {"many": records}


def _threads(arguments: argparse.Namespace) -> Result:
    from ..laboratory.bench.threads import bench_threads
    from ..system.load import load

    system = load(arguments.robot, gravity=(0.0, 0.0, 0.0))
    result = bench_threads(system, members=arguments.members, progress=True)
    times: Records = [
        {"robot": result.robot, "members": result.members, "threads": k + 1, "wall": wall}
        for k, wall in enumerate(result.wall)
    ]
    names = ("sizes", "results", "kept", "extra")
    memory: Records = [
        {"robot": result.robot, **_entries(result, names, k)} for k in range(len(result.sizes))
    ]
    return str(result), {"threads": times, "threads_memory": memory}


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


def _write(folder: Path | None, name: str, records: Records) -> None:
    """Write records with equal keys to FOLDER/NAME.csv, if there is a folder."""
    if folder is None:
        return
    from ..common.files import write_table

    path = folder / f"{name}.csv"
    write_table(path, list(records[0]), records)
    print(f"written to {path}")


if TYPE_CHECKING:
    from ..laboratory.bench.accuracy import Effort
    from ..laboratory.bench.problems import Problem
    from ..laboratory.bench.solver import Solver
    from ..laboratory.bench.work_precision import WorkPrecision


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
