"""`pinred reorient`: joint motion from rest to rest that turns the base."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..common.errors import InputError
from .limit_options import add_limits, limits_in
from .options import add_robot, by_joint_in, numbers_in, refuse_of_robots, system_of
from .written import written

if TYPE_CHECKING:
    from ..system.system import System


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_robot(sub, "a name (`pinred robots`), a URDF or MJCF file, or a gait file with [reorient]")
    sub.add_argument(
        "--target", metavar="V1,V2,V3",
        help="rotation vector, or an angle [rad], or a pose of which the attitude is taken",
    )  # fmt: skip
    add_limits(sub)
    sub.add_argument(
        "--x0", metavar="V1,V2,… or J1=V1,…", help="shape at start and end; zero if not given"
    )
    sub.add_argument("--momentum", metavar="V1,V2,…", help="body momentum at the start, or 0")
    sub.add_argument("--cycles", metavar="N", type=int, help="of equal loops; as few as will do")
    sub.add_argument("--time", metavar="T", type=float, help="of all of it (2 s a cycle)")
    sub.add_argument("--compare", action="store_true", help="judge the motion by full ABA")
    sub.add_argument("--out", metavar="FILE", help="traj.npz or traj.csv, or a figure")


def run(options: argparse.Namespace) -> int:
    """Print the plan.  Returns 0, or the verdict of --compare."""
    from ..common.files import DATA, FIGURES, check_path
    from ..judge.report import EXIT_CODES
    from ..planning.reorientation.reorient import reorient

    path = None if options.out is None else check_path(options.out, (*DATA, *FIGURES))
    system, asked = _asked(options)
    if "target" not in asked:
        raise InputError("give --target, numbers separated by commas, or a gait file that has one")
    plan = reorient(system, **asked)
    print(plan)
    print(f"  missed by the motion    {plan.missed:.1e} rad")
    if path is not None:
        if path.suffix in FIGURES:
            from ..views.plots.by_kind import plot
            from .plot import save

            save(plot(plan, "loop"), path)
        else:
            plan.trajectory.save(path)
        print(written(path))
    if options.compare:
        print(plan.report)
        return EXIT_CODES[plan.report.verdict]
    return 0


def _asked(options: argparse.Namespace) -> tuple[System, dict[str, Any]]:
    """Return the robot, and options by the names that Python has for them: file, then words."""
    out: dict[str, Any] = {}
    if Path(options.robot).suffix == ".toml":
        from ..planning.gait_files.load_gait import load_gait

        refuse_of_robots(options, options.robot, "group", "lock", "gravity", "root", "parameter")
        file = load_gait(options.robot)
        system = file.system
        out |= file.reorient
    else:
        system = system_of(options)
    if options.target is not None:
        out["target"] = numbers_in(options.target, "target")
        if not out["target"]:
            raise InputError("--target takes numbers separated by commas, got nothing")
    if options.x0 is not None:
        out["x0"] = by_joint_in(options.x0, "x0")
    momentum = numbers_in(options.momentum, "momentum")
    if momentum is not None:
        out["momentum"] = 0 if momentum == [0.0] else momentum
    for name, value in (("cycles", options.cycles), ("duration", options.time)):
        if value is not None:
            out[name] = value
    return system, out | limits_in(options)
