"""`pinred reorient`: joint motion from rest to rest that turns the base."""

from __future__ import annotations

import argparse

from ..common.errors import InputError
from .limit_options import add_limits, limits_in
from .options import add_robot, by_joint_in, numbers_in, system_of
from .written import written


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_robot(sub)
    sub.add_argument(
        "--target", metavar="V1,V2,V3", required=True,
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
    sub.add_argument("--out", metavar="FILE", help="traj.npz or traj.csv")


def run(options: argparse.Namespace) -> int:
    """Print the plan.  Returns 0, or the verdict of --compare."""
    from ..common.files import check_path
    from ..planning.reorientation.reorient import reorient
    from ..verification.report import EXIT_CODES

    path = None if options.out is None else check_path(options.out)
    target = numbers_in(options.target, "target")
    if not target:
        raise InputError("--target takes numbers separated by commas, got nothing")
    momentum = numbers_in(options.momentum, "momentum")
    plan = reorient(
        system_of(options),
        target,
        x0=None if options.x0 is None else by_joint_in(options.x0, "x0"),
        momentum=0 if momentum in (None, [0.0]) else momentum,
        cycles=options.cycles,
        duration=options.time,
        **limits_in(options),
    )
    print(plan)
    print(f"  missed by the motion    {plan.missed:.1e} rad")
    if path is not None:
        plan.trajectory.save(path)
        print(written(path))
    if options.compare:
        print(plan.report)
        return EXIT_CODES[plan.report.verdict]
    return 0
