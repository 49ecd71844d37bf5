"""`pinred robots`: list the robots that can be loaded by name."""

from __future__ import annotations

import argparse
import warnings

from ..common.errors import PinredError


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    sub.add_argument("--check", action="store_true", help="load each robot and print errors")


def run(arguments: argparse.Namespace) -> int:
    """Print the names of the robots.  Returns 0."""
    from ..system import catalogue

    bundled = catalogue.bundled_robots()
    width = max(map(len, bundled))
    print("bundled:")
    for name, robot in bundled.items():
        print(f"  {name:<{width}}  {robot.group:<3}  {robot.description}")
    examples = catalogue.example_robots()
    if not examples:
        print(f"more (solo12, talos, ur5, …): {catalogue.INSTALL_ROBOTS}")
        return 0
    print("from example-robot-data:")
    if not arguments.check:
        print("  " + ", ".join(examples))
        return 0
    from ..system.load import load

    width = max(map(len, examples))
    for name in examples:
        try:
            with warnings.catch_warnings(record=True) as caught:
                system = load(name)
            print(
                f"  {name:<{width}}  {system.group.name:<3}  {system.m} joints, {system.mass:g} kg"
            )
            for warning in caught:
                print(f"  {'':<{width}}  warning: {warning.message}")
        except PinredError as error:
            print(f"  {name:<{width}}  refused: {error}")
    return 0
