"""`pinred compare`: simulate the reduced equations and compare the motion with full ABA."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from .command_options import add_robot, add_scene, scene_of
from .output_files import print_report

if TYPE_CHECKING:
    from ..simulation.trajectory import Trajectory


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_robot(sub)
    add_scene(sub)
    sub.add_argument(
        "--budget", type=float, metavar="S",
        help="processor time after which ABA stops [s] (default: 30, or 500 times the run's)",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Simulate and compare.  Returns 0 for PASSED, 1 for FAILED, 3 for CANNOT TELL."""
    from ..simulation.simulate import simulate

    scene, engine = scene_of(arguments), arguments.engine
    traj = simulate(scene, engine=engine, check=arguments.check, progress=True)
    return print_comparison(traj, arguments.budget)


def print_comparison(traj: Trajectory, budget: float | None = None) -> int:
    """Print the comparison of a motion with full ABA.  Returns 0, 1 or 3, as `run` does."""
    from ..judge.compare import compare

    return print_report(compare(traj, progress=True, budget=budget))
