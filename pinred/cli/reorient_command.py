"""`pinred reorient`: plan a joint motion from rest to rest that rotates the base."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..common.errors import InputError
from .command_options import (
    ROBOT,
    add_robot,
    by_joint_in,
    numbers_in,
    option_adder,
    refuse_of_robots,
    system_of,
)
from .gait_options import add_limits, limits_in
from .output_files import describe_file, save_figure

if TYPE_CHECKING:
    from ..system.system import System


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_robot(sub, f"{ROBOT}, or a gait file with [reorient]")
    add_limits(sub)
    add = option_adder(sub)
    text = "rotation vector or angle [rad], or a pose, whose attitude is the target"
    add("--target V1,V2,V3", text)
    add("--x0 V1,V2,… or J1=V1,…", "shape at start and end [rad | m] (default: zero)")
    add("--momentum V1,V2,…", "initial body momentum [N·s; N·m·s], or 0")
    add("--cycles N", "number of equal loops (default: smallest possible)", int)
    add("--time T", "duration of the motion [s] (default: 2 per cycle)", float)
    add("--compare", "compare the motion with full ABA")
    add("--out FILE", "write the motion (.npz, .csv) or a figure")


def run(arguments: argparse.Namespace) -> int:
    """Print the plan.  Returns 0, or the verdict of --compare."""
    from ..common.files import DATA, FIGURES, check_path
    from ..judge.report import EXIT_CODES
    from ..planning.reorientation.reorient import reorient

    path = None if arguments.out is None else check_path(arguments.out, (*DATA, *FIGURES))
    system, options = _stated(arguments)
    if "target" not in options:
        raise InputError("give --target, numbers separated by commas, or a gait file that has one")
    plan = reorient(system, **options)
    print(plan)
    print(f"  missed by the motion    {plan.missed:.1e} rad")
    if path is not None:
        if path.suffix in FIGURES:
            from ..views.plots.by_kind import plot

            save_figure(plot(plan, "loop"), path)
        else:
            plan.trajectory.save(path)
        print(describe_file(path))
    if arguments.compare:
        print(plan.report)
        return EXIT_CODES[plan.report.verdict]
    return 0


def _stated(arguments: argparse.Namespace) -> tuple[System, dict[str, Any]]:
    """Return the robot, and the options of `reorient` from the file and the arguments."""
    options: dict[str, Any] = {}
    if Path(arguments.robot).suffix == ".toml":
        from ..planning.gait_files.load_gait import load_gait

        refuse_of_robots(
            arguments, arguments.robot, "group", "lock", "gravity", "root", "parameter"
        )
        file = load_gait(arguments.robot)
        system = file.system
        options |= file.reorient
    else:
        system = system_of(arguments)
    if arguments.target is not None:
        options["target"] = numbers_in(arguments.target, "target")
        if not options["target"]:
            raise InputError("--target takes numbers separated by commas, got nothing")
    if arguments.x0 is not None:
        options["x0"] = by_joint_in(arguments.x0, "x0")
    momentum = numbers_in(arguments.momentum, "momentum")
    if momentum is not None:
        options["momentum"] = 0 if momentum == [0.0] else momentum
    for name, value in (("cycles", arguments.cycles), ("duration", arguments.time)):
        if value is not None:
            options[name] = value
    return system, options | limits_in(arguments)
