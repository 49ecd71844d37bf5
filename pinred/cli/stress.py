"""`pinred stress`: the stress suite as a command.

Nothing heavy is imported before it runs.
"""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..laboratory.stress.check import Check


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    sub.add_argument("--only", metavar="A,B,…", help="these checks, with all their cases")
    sub.add_argument(
        "--full", action="store_true", help="long runs too: 1e6 periods, 1e7 steps, more frames"
    )


def run(options: argparse.Namespace) -> int:
    """Run the command.  Returns 0, or 1 if a check fails."""
    from ..laboratory.stress.check import Trial
    from ..laboratory.stress.run_stress import chosen, run_checks, table

    checks = chosen(options.only.split(",") if options.only else ())
    trial = Trial(effort="full" if options.full else "usual")
    outcomes = []
    for outcome in run_checks(checks, trial, begun=_progress):
        outcomes.append(outcome)
        if sys.stderr.isatty():
            sys.stderr.write("\r\033[K")
        verdict = "ok" if outcome.passed else "FAILED"
        print(f"{outcome.name}: {verdict}, {outcome.wall:.1f} s", file=sys.stderr)
        if options.only:
            print(f"{outcome.name}: {outcome.what}")
            for case in outcome.cases:
                print(f"  {case}")
    print(table(outcomes))
    return 0 if all(outcome.passed for outcome in outcomes) else 1


def _progress(check: Check, done: int) -> None:
    """Show how many cases of a check are done, on a terminal."""
    if sys.stderr.isatty():
        sys.stderr.write(f"\r\033[K{check.name}: {done} cases")
        sys.stderr.flush()
