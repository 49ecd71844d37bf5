"""`pinred reorient`: plan a joint motion from rest to rest that rotates the base."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..common.errors import InputError
from .command_options import (
    ROBOT,
    add_options,
    add_robot,
    option_adder,
    options_in,
    refuse_of_robots,
    system_of,
)
from .output_files import write_plan

if TYPE_CHECKING:
    from ..scene.toml.schema import Key
    from ..system.system import System


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_robot(sub, f"{ROBOT}, or a gait file with [reorient]")
    add_options(sub, _keys())
    add = option_adder(sub)
    add("--compare", "compare the motion with full ABA")
    add("--out FILE", "write the motion (.npz, .csv) or a figure")


def run(arguments: argparse.Namespace) -> int:
    """Print the plan.  Returns 0, or the verdict of --compare."""
    from ..common.files import DATA, FIGURES, check_path
    from ..planning.reorientation.reorient import reorient

    path = None if arguments.out is None else check_path(arguments.out, (*DATA, *FIGURES))
    system, options = _stated(arguments)
    if "target" not in options:
        raise InputError("pass --target with comma-separated numbers, or a gait file with a target")
    plan = reorient(system, **options)
    print(plan)
    print(f"  missed by the motion    {plan.missed:.1e} rad")
    return write_plan(plan, path, plan.trajectory.save, compare=arguments.compare)


def _stated(arguments: argparse.Namespace) -> tuple[System, dict[str, Any]]:
    """Return the robot, and the options of `reorient` from the file and the arguments."""
    options: dict[str, Any] = {}
    if Path(arguments.robot).suffix == ".toml":
        from ..planning.gait_file import load_gait

        refuse_of_robots(
            arguments, arguments.robot, "group", "lock", "gravity", "root", "parameters"
        )
        file = load_gait(arguments.robot)
        system = file.system
        options |= file.reorient
    else:
        system = system_of(arguments)
    stated = options_in(arguments, _keys())
    if stated.get("target") == []:
        raise InputError("--target takes numbers separated by commas, got nothing")
    return system, options | stated


def _keys() -> dict[str, Key]:
    """Return the gait-file keys that this command accepts as options."""
    from ..planning.gait_file import GAIT_FILE, REORIENT

    return {**REORIENT.keys, "momentum": GAIT_FILE.keys["momentum"]}
