"""`pinred phase`: what a gait does to the body, cycle after cycle."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from .gait_sources import add_source, source_of
from .options import numbers_in
from .written import written

if TYPE_CHECKING:
    from ..analysis.phases.phase import Phase
    from ..common.arrays import Array


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_source(sub)
    sub.add_argument("--momentum", metavar="V1,V2,…", help="body momentum at the start, or 0")
    sub.add_argument("--tolerance", metavar="TOL", type=float, default=1e-10, help="(1e-10)")
    sub.add_argument("--cycles", metavar="N", type=int, default=1, help="pose after N cycles (1)")
    sub.add_argument(
        "--out", metavar="FILE", help="a figure of the cycles, or poses on the way as npz or csv"
    )


def run(options: argparse.Namespace) -> int:
    """Print the phase.  Returns 0."""
    from ..analysis.phases.phase import phase
    from ..common.files import DATA, FIGURES, check_path

    path = None if options.out is None else check_path(options.out, (*FIGURES, *DATA))
    source = source_of(options, gait=True)
    given = numbers_in(options.momentum, "momentum")
    momentum = source.momentum if given is None else (0 if given == [0.0] else given)
    found = phase(source.connection, source.path, momentum, tolerance=options.tolerance)
    print(f"{source.connection}: one cycle of {source.path.period:g} s")
    _print(found)
    if options.cycles != 1:
        print(_pose(f"after {options.cycles} cycles", found, found.cycles(options.cycles)))
    if path is not None:
        _write(found, path, options.cycles)
        print(written(path))
    return 0


def _print(found: Phase) -> None:
    print(_pose("pose", found, found.pose))
    print(
        f"  {'error at most':<18} {found.error.rotation:.1e} rad, {found.error.translation:.1e} m"
    )
    if found.momentum.any():
        print(_pose("geometric", found, found.geometric))
        print(_pose("dynamic", found, found.dynamic))
    screw = found.screw
    axis = ", ".join(f"{value:.6g}" for value in screw.axis)
    print(f"  {'turn':<18} {screw.angle:.12g} rad about ({axis}), slide {screw.slide:.12g} m")
    if found.length == found.length:  # not NaN
        print(f"  {'length of the gait':<18} {found.length:.12g}, in the metric of the connection")
    print(f"  {'samples':<18} {found.samples}")


def _pose(what: str, found: Phase, pose: Array) -> str:
    names = found.group.pose_names
    values = "  ".join(f"{name} {value:.12g}" for name, value in zip(names, pose, strict=True))
    return f"  {what:<18} {values}"


def _write(found: Phase, path: Path, cycles: int) -> None:
    import numpy as np

    from ..common.files import write_atomic, write_table
    from .plot import save

    if path.suffix == ".npz":
        write_atomic(
            path, lambda file: np.savez(file, t=found.times, pose=found.path, end=found.pose)
        )
    elif path.suffix == ".csv":
        names = ("t", *found.group.pose_names)
        rows = np.column_stack([found.times, found.path]).tolist()
        write_table(path, names, (dict(zip(names, row, strict=True)) for row in rows))
    else:
        from ..views.plots.by_kind import plot

        save(plot(found, "cycles", count=max(1, cycles)), path)
