"""`pinred published`: compare published and closed-form results with those of pinred."""

from __future__ import annotations

import argparse
import sys

from ..common.waiting import Wait
from .command_options import option_adder


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    text = "rows to show in full, with their code (default: a table of all rows)"
    sub.add_argument("rows", nargs="*", metavar="ROW", help=text)
    option_adder(sub)("--list", "list the rows with their sources, and compute nothing")


def run(arguments: argparse.Namespace) -> int:
    """Compute the rows and print them.  Returns 0, or 1 if a row disagrees."""
    from ..laboratory.published import published_rows

    rows = published_rows.select_rows(arguments.rows)
    if arguments.list:
        for row in rows:
            print(f"{row.name:<22} {row.quantity}\n{'':<22} {row.source}")
        return 0
    results = []
    if not arguments.rows:
        print(published_rows.heading())
    for row in rows:
        with Wait(f"computes the row {row.name}"):
            results.append(row.run())
        print((published_rows.report if arguments.rows else published_rows.line)(results[-1]))
        sys.stdout.flush()
    print(published_rows.summary(results))
    return 0 if all(result.passed for result in results) else 1
