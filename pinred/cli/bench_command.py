"""`pinred bench`: run a measurement, print its result, and write it as csv.

Modules that need much memory or time to import are imported by the measurement that needs them.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

from ..common.errors import OutputError
from . import bench_accuracy

Records: TypeAlias = Sequence[dict[str, object]]
Result: TypeAlias = tuple[str, Mapping[str, Records]]  # text to print, and {csv name: records}
Measurement: TypeAlias = Callable[[argparse.Namespace], Result]


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
    bench_accuracy.add_arguments(
        add("accuracy", None, "run time against error, also of other tools")
    )
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
        return bench_accuracy.run(arguments, folder)
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
        raise OutputError(f"cannot make the folder '{path}': {error.strerror}") from error
    return folder


def _write(folder: Path | None, name: str, records: Records) -> None:
    """Write records with equal keys to FOLDER/NAME.csv, if there is a folder."""
    if folder is None:
        return
    from ..common.files import write_table

    path = folder / f"{name}.csv"
    write_table(path, list(records[0]), records)
    print(f"written to {path}")
