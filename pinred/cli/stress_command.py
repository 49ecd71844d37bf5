"""`pinred stress`: run the stress suite."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from .command_options import option_adder

if TYPE_CHECKING:
    from ..laboratory.stress.check import Check


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add = option_adder(sub)
    add("--only A,B,…", "names of checks to run, with all their cases")
    add("--full", "include long runs: 1e6 periods, 1e7 steps, more frames")


def run(arguments: argparse.Namespace) -> int:
    """Run the checks.  Returns 0, or 1 if a check fails."""
    from ..laboratory.stress.check import Trial
    from ..laboratory.stress.run_stress import run_checks, select_checks, table

    checks = select_checks(arguments.only.split(",") if arguments.only else ())
    trial = Trial(effort="full" if arguments.full else "usual")
    outcomes = []
    for outcome in run_checks(checks, trial, on_case=_progress):
        outcomes.append(outcome)
        if sys.stderr.isatty():
            sys.stderr.write("\r\033[K")
        verdict = "ok" if outcome.passed else "FAILED"
        print(f"{outcome.name}: {verdict}, {outcome.wall:.1f} s", file=sys.stderr)
        if arguments.only:
            print(f"{outcome.name}: {outcome.what}")
            for case in outcome.cases:
                print(f"  {case}")
    print(table(outcomes))
    return 0 if all(outcome.passed for outcome in outcomes) else 1


def _progress(check: Check, count: int) -> None:
    """Show on a terminal how many cases of a check have run."""
    if sys.stderr.isatty():
        sys.stderr.write(f"\r\033[K{check.name}: {count} cases")
        sys.stderr.flush()
