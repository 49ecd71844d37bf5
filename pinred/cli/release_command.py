"""`pinred release`: divide a moving robot at a joint."""

from __future__ import annotations

import argparse

from .after_impact import MOTION, add_after, check_after, follow, motion_before
from .command_options import option_adder


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    sub.add_argument("motion", metavar="MOTION", help=f"the robot: {MOTION}")
    add = option_adder(sub)
    add("--link LINK", "link behind the joint that opens, or the joint", required=True)
    add("--root LINK", "link of the released part that its pose describes", default="")
    add_after(sub)


def run(arguments: argparse.Namespace) -> int:
    """Print the release.  Returns 0, or the verdict of --compare."""
    from ..simulation.contact.capture import release

    check_after(arguments)
    motion = motion_before(arguments.motion)
    result = release(motion, arguments.link, root=arguments.root)
    parts = (result.carrier, result.released)
    return follow(arguments, [motion], result, [(part.system, part.start) for part in parts])
