"""`pinred phase`: compute the displacement of the base that each cycle of a gait causes."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from .command_options import add_options, add_source, option_adder, options_in, source_of
from .output_files import describe_file, save_figure, write_series

if TYPE_CHECKING:
    from ..analysis.phases.phase import Phase


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    from ..planning.gait_file import GAIT_FILE

    add_source(sub)
    add_options(sub, {"momentum": GAIT_FILE.keys["momentum"]})
    add = option_adder(sub)
    add("--tolerance TOL", "tolerance of the pose", float, 1e-10)
    add("--cycles N", "number of cycles", int, 1)
    add("--out FILE", "figure of the cycles, or .npz or .csv file of the poses")


def run(arguments: argparse.Namespace) -> int:
    """Print the phase.  Returns 0."""
    from ..analysis.phases.phase import phase
    from ..common.files import DATA, FIGURES, check_path
    from ..planning.gait_file import GAIT_FILE

    path = None if arguments.out is None else check_path(arguments.out, (*FIGURES, *DATA))
    source = source_of(arguments, gait=True)
    stated = options_in(arguments, {"momentum": GAIT_FILE.keys["momentum"]})
    momentum = stated.get("momentum", source.momentum)
    result = phase(source.connection, source.path, momentum, tolerance=arguments.tolerance)
    print(f"{source.connection.title()}: {result}")
    if (n := arguments.cycles) != 1:
        print(f"  {f'after {n} cycles':<18} {result.in_words(result.cycles(n))}")
    if path is not None:
        _write(result, path, arguments.cycles)
        print(describe_file(path))
    return 0


def _write(result: Phase, path: Path, cycles: int) -> None:
    from ..common.files import FIGURES

    if path.suffix in FIGURES:
        from ..views.plots.by_kind import plot

        save_figure(plot(result, "cycles", count=max(1, cycles)), path)
        return
    arrays = {"t": result.times, "pose": result.path, "end": result.pose}
    write_series(path, ("t", *result.group.pose_names), arrays)
