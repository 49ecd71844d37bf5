"""`pinred bench`: the measurements as commands, printed and written as csv.

Nothing heavy is imported before a measurement runs.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeAlias

from ..common.errors import OutputError
from . import bench_accuracy as accuracy_command

Row: TypeAlias = dict[str, object]
Measurement: TypeAlias = Callable[[argparse.Namespace], int]


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add a command for each measurement; each sets `measure`."""
    commands = sub.add_subparsers(title="measurements", metavar="WHAT", required=True)

    def command(name: str, measure: Measurement, text: str) -> argparse.ArgumentParser:
        sub: argparse.ArgumentParser = commands.add_parser(name, help=text, description=text)
        sub.set_defaults(measure=measure)
        sub.add_argument("--out", metavar="FOLDER", help="write the numbers there, as csv")
        return sub

    sub = command("kernels", _kernels, "one evaluation against pin.aba")
    sub.add_argument("robots", nargs="*", metavar="ROBOT", help="robots; a few if none is named")
    sub = command("forces", _forces, "kernels with forces that see the base, against none")
    sub.add_argument("robots", nargs="*", metavar="ROBOT", help="robots; four if none is named")
    sub = command("accuracy", _accuracy, "run time against error, and against other tools")
    accuracy_command.add_arguments(sub)
    sub = command("evaluations", _evaluations, "evaluations that an error costs, by many methods")
    sub.add_argument("scenes", nargs="*", metavar="SCENE", help="four if none is named")
    sub = command("flow", _flow, "calls, gradients and free inertias of flows")
    sub.add_argument("robots", nargs="*", metavar="ROBOT", help="robots; four if none is named")
    command("scaling", _scaling, "one evaluation of chains of 5 to 100 joints")
    command("floquet", _floquet, "Floquet multipliers by three routes, against their closed form")
    sub = command("many", _many, "trajectories per second of many members, by pinred and others")
    sub.add_argument("scenes", nargs="*", metavar="SCENE", help="five if none is named")
    sub.add_argument("--members", metavar="N", type=int, default=512, help="trajectories (512)")
    sub = command("threads", _threads, "simulate_many on one and two threads, and its memory")
    sub.add_argument("robot", nargs="?", default="solo12", metavar="ROBOT", help="(solo12)")
    sub.add_argument("--members", metavar="N", type=int, default=1000, help="trajectories (1000)")


def run(options: argparse.Namespace) -> int:
    """Make the measurement asked for, print it, and write it.  Returns 0."""
    measure: Measurement = options.measure
    return measure(options)


def _kernels(options: argparse.Namespace) -> int:
    folder = _folder(options.out)
    from ..laboratory.bench.kernel_timing import KernelTiming, bench_kernels

    timings = bench_kernels(options.robots, progress=True)
    print(KernelTiming.header())
    for timing in timings:
        print(timing)
    _write(folder, "kernels", [{**vars(timing), "ratio": timing.ratio} for timing in timings])
    return 0


def _forces(options: argparse.Namespace) -> int:
    folder = _folder(options.out)
    from ..laboratory.bench.force_timing import ForcesTiming, bench_forces

    timings = bench_forces(options.robots, progress=True)
    print(ForcesTiming.header())
    for timing in timings:
        print(timing)
    names = ("robot", "free", "torque", "wrench", "full")
    _write(folder, "forces", [{name: getattr(each, name) for name in names} for each in timings])
    return 0


def _accuracy(options: argparse.Namespace) -> int:
    return accuracy_command.run(options, _folder(options.out))


def _evaluations(options: argparse.Namespace) -> int:
    folder = _folder(options.out)
    from ..laboratory.bench.evaluations import ERRORS, FEW_SCENES, bench_evaluations

    found = bench_evaluations(options.scenes or FEW_SCENES, progress=True)
    print("\n\n".join(map(str, found)))
    rows: list[Row] = [
        {"problem": each.problem, "method": name, "error": error, "evaluations": count}
        for each in found
        for name, counts in each.counts.items()
        for error, count in zip(ERRORS, counts, strict=True)
    ]
    _write(folder, "evaluations", rows)
    return 0


def _flow(options: argparse.Namespace) -> int:
    folder = _folder(options.out)
    from ..laboratory.bench.flow_timing import FlowTiming, bench_flow

    timings = bench_flow(options.robots, progress=True)
    print(FlowTiming.header())
    for timing in timings:
        print(timing)
    _write(folder, "flow", [dict(vars(timing)) for timing in timings])
    return 0


def _scaling(options: argparse.Namespace) -> int:
    folder = _folder(options.out)
    from ..laboratory.bench.scaling import bench_scaling

    found = bench_scaling(progress=True)
    print("\n\n".join(map(str, found)))
    names = ("joints", "instructions", "build", "kernel")
    rows = [
        {"family": each.family, **{name: getattr(each, name)[k] for name in names}}
        for each in found
        for k in range(len(each.joints))
    ]
    _write(folder, "scaling", rows)
    return 0


def _floquet(options: argparse.Namespace) -> int:
    folder = _folder(options.out)
    from ..laboratory.bench.floquet_timing import ROUTES, bench_floquet

    found = bench_floquet(progress=True)
    print("\n\n".join(map(str, found)))
    rows: list[Row] = [
        {"robot": each.robot, "route": name, "wall": wall, "error": error}
        for each in found
        for name, wall, error in zip(ROUTES, each.wall, each.error, strict=True)
    ]
    _write(folder, "floquet", rows)
    return 0


def _many(options: argparse.Namespace) -> int:
    folder = _folder(options.out)
    from ..laboratory.bench.batch_timing import bench_many

    found = bench_many(options.scenes or None, members=options.members, progress=True)
    print("\n\n".join(map(str, found)))
    rows: list[Row] = [
        {"problem": each.problem, "members": each.members, **vars(rate)}
        for each in found
        for rate in each.rates
    ]
    _write(folder, "many", rows)
    return 0


def _threads(options: argparse.Namespace) -> int:
    folder = _folder(options.out)
    from ..laboratory.bench.threads import bench_threads
    from ..system.load import load

    system = load(options.robot, gravity=(0.0, 0.0, 0.0))
    found = bench_threads(system, members=options.members, progress=True)
    print(found)
    rows: list[Row] = [
        {"robot": found.robot, "members": found.members, "threads": k + 1, "wall": wall}
        for k, wall in enumerate(found.wall)
    ]
    _write(folder, "threads", rows)
    names = ("sizes", "results", "kept", "extra")
    memory: list[Row] = [
        {"robot": found.robot, **{name: getattr(found, name)[k] for name in names}}
        for k in range(len(found.sizes))
    ]
    _write(folder, "threads_memory", memory)
    return 0


def _folder(path: str | None) -> Path | None:
    """Return a folder to write to, made if need be, before anything is measured."""
    if path is None:
        return None
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot make the folder '{path}': {error.strerror}") from error
    return folder


def _write(folder: Path | None, name: str, rows: Sequence[Row]) -> None:
    """Write rows of equal keys to FOLDER/name.csv, whole or not at all."""
    if folder is None:
        return
    from ..common.files import write_table

    path = folder / f"{name}.csv"
    write_table(path, list(rows[0]), rows)
    print(f"written to {path}")
