"""`pinred gait`: the loop that does most to the body for what it costs."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..common.errors import InputError
from .gait_sources import source_of
from .limit_options import add_limits, limits_in
from .options import add_parameters, numbers_in, one_of
from .written import written

if TYPE_CHECKING:
    from ..analysis.gaits.gait import Gait

_SAMPLES = 400
_PLAIN = ("objective", "most", "harmonics", "vertices", "period", "starts", "seed")


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    from ..planning.optimisation.aims import AIMS
    from ..planning.optimisation.costs import COSTS

    sub.add_argument(
        "source", metavar="SOURCE",
        help="a gait file (.toml), for its connection and objective, or a robot (`pinred robots`, "
        "a file)",
    )  # fmt: skip
    sub.add_argument("--group", metavar="G", help="the symmetry of a robot")
    add_parameters(sub, "a number of a robot")
    sub.add_argument("--objective", metavar="O", help=one_of(AIMS, AIMS[0]))
    sub.add_argument("--axis", metavar="A", help="x, y, z, or V1,V2,…: about or along which")
    sub.add_argument("--target", metavar="V1,…", help="of objective target: rotation [rad] or pose")
    sub.add_argument("--cost", metavar="C", help=one_of((*COSTS, "none"), COSTS[0]))
    sub.add_argument("--most", metavar="C", type=float, help="bound on the cost")
    sub.add_argument("--harmonics", metavar="H", type=int, help="(5)")
    sub.add_argument("--vertices", metavar="N", type=int, help="a polygon instead")
    sub.add_argument("--any-winding", action="store_true", help="do not hold the winding number")
    add_limits(sub)
    sub.add_argument("--period", metavar="T", type=float, help="(1 s)")
    sub.add_argument("--starts", metavar="N", type=int, help="random first loops (5)")
    sub.add_argument("--seed", metavar="S", type=int, help="of their numbers (0)")
    sub.add_argument("--compare", action="store_true", help="judge a cycle by full ABA")
    sub.add_argument(
        "--out", metavar="FILE",
        help="the loop as joint data, npz or csv, or a figure of it on the curvature",
    )  # fmt: skip


def run(options: argparse.Namespace) -> int:
    """Print the best loop and its certificate.  Returns 0, or the verdict of --compare."""
    from ..common.files import DATA, FIGURES, check_path
    from ..judge.report import EXIT_CODES
    from ..planning.optimisation.optimise import optimise_gait

    path = None if options.out is None else check_path(options.out, (*DATA, *FIGURES))
    options.gait = options.circle = None
    source = source_of(options, gait=False)
    best = optimise_gait(source.connection, **{**source.optimise, **_given(options)}, progress=True)
    print(best)
    if path is not None:
        if path.suffix in FIGURES:
            from ..views.plots.by_kind import plot
            from .plot import save

            save(plot(best, "loop"), path)
        else:
            _write(best.gait, source.connection.joints, path)
        print(written(path))
    if options.compare:
        print(best.report)
        return EXIT_CODES[best.report.verdict]
    return 0


def _given(options: argparse.Namespace) -> dict[str, Any]:
    """Return the options that are given, by the names that Python has for them."""
    out: dict[str, Any] = {
        name: getattr(options, name) for name in _PLAIN if getattr(options, name) is not None
    }
    if options.axis is not None:
        axis = options.axis
        out["axis"] = axis if axis in ("x", "y", "z") else numbers_in(axis, "axis")
    if options.target is not None:
        out["target"] = numbers_in(options.target, "target")
    if options.cost is not None:
        out["cost"] = None if options.cost == "none" else options.cost
    if options.any_winding:
        out["winding"] = None
    return out | limits_in(options)


def _write(gait: Gait, joints: tuple[str, ...], path: Path) -> None:
    """Write a cycle as joint data, which `Gait.read` reads."""
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
