"""`pinred gait`: the loop that does most to the body for what it costs."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..common.errors import InputError
from .gait_sources import source_of
from .limit_options import add_limits, limits_in
from .options import numbers_in, one_of
from .written import written

if TYPE_CHECKING:
    from ..analysis.gaits.gait import Gait

SUFFIXES = (".npz", ".csv")
_SAMPLES = 400


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    from ..planning.optimisation.aims import AIMS
    from ..planning.optimisation.costs import COSTS

    sub.add_argument(
        "source", metavar="SOURCE",
        help="a gait file (.toml), for its connection, or a robot (`pinred robots`, a file)",
    )  # fmt: skip
    sub.add_argument("--group", metavar="G", help="the symmetry of a robot")
    sub.add_argument("--objective", metavar="O", default=AIMS[0], help=one_of(AIMS, AIMS[0]))
    sub.add_argument("--axis", metavar="A", help="x, y, z, or V1,V2,…: about or along which")
    sub.add_argument("--target", metavar="V1,…", help="of objective target: rotation [rad] or pose")
    sub.add_argument(
        "--cost", metavar="C", default=COSTS[0], help=one_of((*COSTS, "none"), COSTS[0])
    )
    sub.add_argument("--most", metavar="C", type=float, help="bound on the cost")
    sub.add_argument("--harmonics", metavar="H", type=int, default=5, help="(5)")
    sub.add_argument("--vertices", metavar="N", type=int, help="a polygon instead")
    sub.add_argument("--any-winding", action="store_true", help="do not hold the winding number")
    add_limits(sub)
    sub.add_argument("--period", metavar="T", type=float, default=1.0, help="(1 s)")
    sub.add_argument("--starts", metavar="N", type=int, default=5, help="random first loops (5)")
    sub.add_argument("--seed", metavar="S", type=int, default=0, help="of their numbers (0)")
    sub.add_argument("--compare", action="store_true", help="judge a cycle by full ABA")
    sub.add_argument("--out", metavar="FILE", help="the loop as joint data, npz or csv")


def run(options: argparse.Namespace) -> int:
    """Print the best loop and its certificate.  Returns 0, or the verdict of --compare."""
    from ..common.files import check_path
    from ..planning.optimisation.optimise import optimise_gait
    from ..verification.report import EXIT_CODES

    path = None if options.out is None else check_path(options.out, SUFFIXES)
    options.gait = options.circle = None
    connection = source_of(options, gait=False).connection
    given: dict[str, Any] = limits_in(options)
    axis = options.axis
    if axis is not None and axis not in ("x", "y", "z"):
        axis = numbers_in(axis, "axis")
    target = numbers_in(options.target, "target")
    best = optimise_gait(
        connection,
        objective=options.objective,
        axis=axis,
        target=target,
        cost=None if options.cost == "none" else options.cost,
        most=options.most,
        harmonics=options.harmonics,
        vertices=options.vertices,
        winding=None if options.any_winding else 1,
        period=options.period,
        starts=options.starts,
        seed=options.seed,
        progress=True,
        **given,
    )
    print(best)
    if path is not None:
        _write(best.gait, connection.joints, path)
        print(written(path))
    if options.compare:
        print(best.report)
        return EXIT_CODES[best.report.verdict]
    return 0


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
