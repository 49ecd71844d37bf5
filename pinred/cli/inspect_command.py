"""`pinred inspect`: print the symmetry and the reduced quantities of a robot at one shape."""

from __future__ import annotations

import argparse

from .command_options import add_robot, system_of
from .option_values import numbers_in


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_robot(sub)
    sub.add_argument("--at", metavar="X1,X2,…", help="shape [rad | m] (default: zero)")


def run(arguments: argparse.Namespace) -> int:
    """Print the inspection.  Returns 0."""
    from ..analysis.inspection import inspect

    print(inspect(system_of(arguments), numbers_in(arguments.at, "at")))
    return 0
