"""`pinred compare`: simulate the reduced equations and judge them by full ABA."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from .options import add_robot, add_scene, scene_of

if TYPE_CHECKING:
    from ..simulation.trajectory import Trajectory


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_robot(sub)
    add_scene(sub)


def run(options: argparse.Namespace) -> int:
    """Simulate and judge.  Returns 0 for PASSED, 1 for FAILED, 3 for CANNOT TELL."""
    from ..simulation.simulate import simulate

    return judged(simulate(scene_of(options), engine=options.engine, progress=True))


def judged(traj: Trajectory) -> int:
    """Print the comparison of a motion with full ABA.  Returns 0, 1 or 3, as `run` does."""
    from ..judge.compare import compare
    from ..judge.report import EXIT_CODES

    report = compare(traj, progress=True)
    print(report)
    return EXIT_CODES[report.verdict]
