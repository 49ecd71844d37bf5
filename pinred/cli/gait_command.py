"""`pinred gait`: find the gait with the largest displacement of the base for its cost."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..common.errors import InputError
from .command_options import add_parameters, numbers_in, option_adder
from .gait_options import add_limits, limits_in, source_of
from .output_files import describe_file, save_figure

if TYPE_CHECKING:
    from ..analysis.gaits.gait import Gait

_SAMPLES = 400  # number of samples of a cycle in a file
_PLAIN = ("objective", "most", "harmonics", "vertices", "period", "starts", "seed")


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    from ..planning.optimisation.aims import AIMS
    from ..planning.optimisation.costs import COSTS

    text = "gait file (.toml) with connection and objective, or robot: a name or a file"
    sub.add_argument("source", metavar="SOURCE", help=text)
    add = option_adder(sub)
    add("--group G", "symmetry group of a robot")
    add_parameters(sub)
    add("--objective O", f"objective: {', '.join(AIMS)} (default: {AIMS[0]})")
    add("--axis A", "axis of the displacement: x, y, z, or V1,V2,…")
    add("--target V1,…", "rotation [rad] or pose of objective target")
    add("--cost C", f"cost: {', '.join(COSTS)} or none (default: {COSTS[0]})")
    add("--most C", "upper bound on the cost", float)
    add("--harmonics H", "number of Fourier harmonics (default: 5)", int)
    add("--vertices N", "number of vertices of a polygon, instead of harmonics", int)
    add("--any-winding", "let the winding number vary")
    add_limits(sub)
    add("--period T", "time of one cycle [s] (default: 1)", float)
    add("--starts N", "number of random initial loops (default: 5)", int)
    add("--seed S", "seed of the random initial loops (default: 0)", int)
    add("--compare", "compare a cycle with full ABA")
    add("--out FILE", "gait as joint data (.npz, .csv), or figure of it on the curvature")


def run(arguments: argparse.Namespace) -> int:
    """Print the best loop and its certificate.  Returns 0, or the verdict of --compare."""
    from ..common.files import DATA, FIGURES, check_path
    from ..judge.report import EXIT_CODES
    from ..planning.optimisation.optimise import optimise_gait

    path = None if arguments.out is None else check_path(arguments.out, (*DATA, *FIGURES))
    arguments.gait = arguments.circle = None
    source = source_of(arguments, gait=False)
    best = optimise_gait(
        source.connection, **{**source.optimise, **_stated(arguments)}, progress=True
    )
    print(best)
    if path is not None:
        if path.suffix in FIGURES:
            from ..views.plots.by_kind import plot

            save_figure(plot(best, "loop"), path)
        else:
            _write(best.gait, source.connection.joints, path)
        print(describe_file(path))
    if arguments.compare:
        print(best.report)
        return EXIT_CODES[best.report.verdict]
    return 0


def _stated(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the stated options by their names in Python."""
    values: dict[str, Any] = {
        name: getattr(arguments, name) for name in _PLAIN if getattr(arguments, name) is not None
    }
    if arguments.axis is not None:
        axis = arguments.axis
        values["axis"] = axis if axis in ("x", "y", "z") else numbers_in(axis, "axis")
    if arguments.target is not None:
        values["target"] = numbers_in(arguments.target, "target")
    if arguments.cost is not None:
        values["cost"] = None if arguments.cost == "none" else arguments.cost
    if arguments.any_winding:
        values["winding"] = None
    return values | limits_in(arguments)


def _write(gait: Gait, joints: tuple[str, ...], path: Path) -> None:
    """Write a cycle as joint data in the format of `Gait.read`."""
    import numpy as np

    from ..common.files import write_atomic, write_table

    if not np.isfinite(gait.period):
        raise InputError("a gait without a period cannot be written")
    t = np.linspace(0.0, gait.period, _SAMPLES + 1)
    x = gait.at(np.append(t[:-1], 0.0))[0]
    if path.suffix == ".npz":
        write_atomic(path, lambda file: np.savez(file, t=t, x=x))
        return
    names = ("t", *joints)
    rows = np.column_stack([t, x]).tolist()
    write_table(path, names, (dict(zip(names, row, strict=True)) for row in rows))
