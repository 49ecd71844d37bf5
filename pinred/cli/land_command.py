"""`pinred land`: stop frames of a robot in flight dead at the ground."""

from __future__ import annotations

import argparse

from ..common.errors import InputError
from .after_impact import MOTION, add_after, check_after, follow, motion_before
from .command_options import option_adder


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    sub.add_argument("motion", metavar="MOTION", help=f"the robot in flight: {MOTION}")
    add = option_adder(sub)
    add("--frame F[,F2]", "link or frame that stops, or several at once", required=True)
    add("--contact C", "point: its origin stops; flat: it stops turning, too", str, "point")
    add_after(sub)


def run(arguments: argparse.Namespace) -> int:
    """Print the landing.  Returns 0, or the verdict of --compare."""
    from ..simulation.contact.landing import land

    check_after(arguments)
    motion = motion_before(arguments.motion)
    landing = land(motion, arguments.frame.split(","), contact=arguments.contact)
    stance = landing.stance
    if stance is None and arguments.duration is not None:
        raise InputError(f"--duration: {landing.why_no_stance}")
    states = [] if stance is None else [(stance.system, stance.start)]
    return follow(arguments, [motion], landing, states)
