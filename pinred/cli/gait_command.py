"""`pinred gait`: find the gait with the largest displacement of the base for its cost."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..common.errors import InputError
from .command_options import (
    add_options,
    add_parameters,
    connection_keys,
    option_adder,
    options_in,
    source_of,
)
from .output_files import write_plan, write_series

if TYPE_CHECKING:
    from ..analysis.gaits.gait import Gait

_SAMPLES = 400  # number of samples of a cycle in a file


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    from ..planning.gait_file import OPTIMISE

    text = "gait file (.toml) with connection and objective, or robot: a name or a file"
    sub.add_argument("source", metavar="SOURCE", help=text)
    add_options(sub, {**connection_keys(), **OPTIMISE.keys})
    add_parameters(sub)
    add = option_adder(sub)
    add("--any-winding", "let the winding number vary")
    add("--distance", "print the distance from the extremal, or from twice the harmonics")
    add("--compare", "compare a cycle with full ABA")
    add("--out FILE", "gait as joint data (.npz, .csv), or figure of it on the curvature")


def run(arguments: argparse.Namespace) -> int:
    """Print the best loop and its certificate.  Returns 0, or the verdict of --compare."""
    from ..common.files import DATA, FIGURES, check_path
    from ..planning.optimisation.optimise import optimise_gait

    path = None if arguments.out is None else check_path(arguments.out, (*DATA, *FIGURES))
    arguments.gait = arguments.circle = None
    source = source_of(arguments, gait=False)
    best = optimise_gait(
        source.connection, **{**source.optimise, **_stated(arguments)}, progress=True
    )
    print(best)
    if arguments.distance:
        print(f"  distance from optimum: {best.distance()}")
    return write_plan(
        best,
        path,
        lambda file: _write(best.gait, source.connection.joints, file),
        compare=arguments.compare,
    )


def _stated(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return {Python name: value} of the options that the user passed."""
    from ..planning.gait_file import OPTIMISE

    options = options_in(arguments, OPTIMISE.keys)
    if options.get("cost") == "none":
        options["cost"] = None
    if arguments.any_winding:
        options["winding"] = None
    return options


def _write(gait: Gait, joints: tuple[str, ...], path: Path) -> None:
    """Write a cycle as joint data in the format of `Gait.read`."""
    import numpy as np

    if not np.isfinite(gait.period):
        raise InputError("a gait without a period cannot be written")
    t = np.linspace(0.0, gait.period, _SAMPLES + 1)
    x = gait.at(np.append(t[:-1], 0.0))[0]
    write_series(path, ("t", *joints), {"t": t, "x": x})
