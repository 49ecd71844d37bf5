"""`pinred bench`: the measurements as commands, printed and written as csv.

Nothing heavy is imported before a measurement runs.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from ..errors import InputError, OutputError
from ..progress import ProgressBar

if TYPE_CHECKING:
    from .accuracy import WorkPrecision

Row = dict[str, object]


def add_measurements(parser: argparse.ArgumentParser) -> None:
    """Add a command a measurement to a parser; each sets `run`."""
    commands = parser.add_subparsers(title="measurements", metavar="WHAT", required=True)

    def command(name: str, run: Any, text: str) -> argparse.ArgumentParser:
        sub: argparse.ArgumentParser = commands.add_parser(name, help=text, description=text)
        sub.set_defaults(run=run)
        sub.add_argument("--out", metavar="FOLDER", help="write the numbers there, as csv")
        return sub

    sub = command("kernels", _kernels, "one evaluation against pin.aba")
    sub.add_argument("robots", nargs="*", metavar="ROBOT", help="robots; a few if none is named")
    sub = command("accuracy", _accuracy, "run time against error, and against other integrators")
    sub.add_argument("problems", nargs="*", metavar="PROBLEM", help="planar, solo12; both")
    sub.add_argument("--slow", action="store_true", help="heyoka too where it compiles for minutes")
    command("scaling", _scaling, "one evaluation of chains of 5 to 100 joints")
    sub = command("many", _many, "simulate_many on one and two threads, and its memory")
    sub.add_argument("robot", nargs="?", default="solo12", metavar="ROBOT", help="(solo12)")
    sub.add_argument("--members", metavar="N", type=int, default=1000, help="trajectories (1000)")


def _kernels(options: argparse.Namespace) -> int:
    folder = _folder(options.out)
    from .kernels import KernelTiming, bench_kernels

    with ProgressBar("kernels") as bar:
        timings = bench_kernels(options.robots, progress=bar)
    print(KernelTiming.header())
    for timing in timings:
        print(timing)
    _write(folder, "kernels", [{**vars(timing), "ratio": timing.ratio} for timing in timings])
    return 0


def _accuracy(options: argparse.Namespace) -> int:
    folder = _folder(options.out)
    from .accuracy import bench_accuracy
    from .methods import METHODS, SLOW_METHODS
    from .problems import PROBLEMS, default_problems

    if unknown := set(options.problems) - set(PROBLEMS):
        raise InputError(f"no problem '{min(unknown)}'; they are {', '.join(PROBLEMS)}")
    missing: list[str] = []
    if options.problems:
        problems = [PROBLEMS[name]() for name in options.problems]
    else:
        problems, missing = default_problems()
    with ProgressBar("accuracy") as bar:
        found = bench_accuracy(
            problems, methods=SLOW_METHODS if options.slow else METHODS, progress=bar
        )
    print("\n\n".join([*map(str, found), *missing]))
    points = [
        {"problem": each.problem, **vars(point), "error": point.error}
        for each in found
        for point in each.points
    ]
    _write(folder, "accuracy", points)
    _write(folder, "equal_error", [row for each in found for row in _equal_error(each)])
    return 0


def _equal_error(found: WorkPrecision) -> list[Row]:
    from .accuracy import ERRORS

    return [
        {
            "problem": found.problem,
            "error": error,
            "method": method,
            "wall": found.wall_at(method, error),
            "reference_error": found.reference_error,
        }
        for error in ERRORS
        for method in found.about
    ]


def _scaling(options: argparse.Namespace) -> int:
    folder = _folder(options.out)
    from .scaling import bench_scaling

    with ProgressBar("scaling") as bar:
        found = bench_scaling(progress=bar)
    print("\n\n".join(map(str, found)))
    names = ("joints", "instructions", "build", "kernel")
    rows = [
        {"family": each.family, **{name: getattr(each, name)[k] for name in names}}
        for each in found
        for k in range(len(each.joints))
    ]
    _write(folder, "scaling", rows)
    return 0


def _many(options: argparse.Namespace) -> int:
    folder = _folder(options.out)
    from ..loading import load
    from .many import bench_many

    system = load(options.robot, gravity=(0.0, 0.0, 0.0))
    with ProgressBar("many") as bar:
        found = bench_many(system, members=options.members, progress=bar)
    print(found)
    rows: list[Row] = [
        {"robot": found.robot, "members": found.members, "threads": k + 1, "wall": wall}
        for k, wall in enumerate(found.wall)
    ]
    _write(folder, "many", rows)
    names = ("sizes", "results", "kept", "extra")
    memory: list[Row] = [
        {"robot": found.robot, **{name: getattr(found, name)[k] for name in names}}
        for k in range(len(found.sizes))
    ]
    _write(folder, "many_memory", memory)
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
    import csv
    from io import StringIO

    from ..export import write_atomic

    text = StringIO()
    table = csv.DictWriter(text, fieldnames=list(rows[0]), lineterminator="\n")
    table.writeheader()
    table.writerows(rows)

    def write(file: BinaryIO) -> None:
        file.write(text.getvalue().encode())

    path = folder / f"{name}.csv"
    try:
        write_atomic(path, write)
    except OSError as error:
        raise OutputError(f"cannot write '{path}': {error.strerror or error}") from error
    print(f"written to {path}")
