"""`pinred capture`: fix a frame of one moving robot to a frame of another."""

from __future__ import annotations

import argparse

from .after_impact import MOTION, add_after, check_after, follow, motion_before
from .command_options import option_adder


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    sub.add_argument("first", metavar="FIRST", help=f"the robot that captures: {MOTION}")
    sub.add_argument("second", metavar="SECOND", help="the other robot, at the same time")
    add = option_adder(sub)
    add("--at FRAME", "link or frame of the first", required=True)
    add("--onto FRAME", "link or frame of the second", required=True)
    add("--tolerance T", "largest distance [m] and angle [rad] of the frames", float, 1e-6)
    add("--prefix P", "text before the names of the second")
    add_after(sub)


def run(arguments: argparse.Namespace) -> int:
    """Print the capture.  Returns 0, or the verdict of --compare."""
    from ..simulation.contact.capture import capture

    check_after(arguments)
    motions = [motion_before(path) for path in (arguments.first, arguments.second)]
    result = capture(
        motions[0], motions[1], at=arguments.at, onto=arguments.onto,
        tolerance=arguments.tolerance, prefix=arguments.prefix,
    )  # fmt: skip
    return follow(arguments, motions, result, [(result.system, result.start)])
