"""`pinred inspect`: a robot as pinred sees it, at one shape."""

from __future__ import annotations

import argparse

from .options import add_robot, numbers_in, system_of


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_robot(sub)
    sub.add_argument("--at", metavar="X1,X2,…", help="the shape [rad | m]; zero if not given")


def run(options: argparse.Namespace) -> int:
    """Print the inspection.  Returns 0."""
    from ..analysis.inspection import inspect

    print(inspect(system_of(options), numbers_in(options.at, "at")))
    return 0
