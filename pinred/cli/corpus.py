"""`pinred corpus`: every robot description in some folders, tried and judged, as a table.

Nothing heavy is imported before it runs.
"""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..laboratory.corpus.corpus_entry import Entry


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    sub.add_argument("folders", nargs="*", metavar="FOLDER", help="with URDF and MJCF files")
    sub.add_argument(
        "--robots", action="store_true", help="try all names of `pinred robots` as well"
    )
    sub.add_argument("--time", metavar="T", type=float, default=0.5, help="of motions [s] (0.5)")
    sub.add_argument(
        "--patience", metavar="S", type=float, default=60.0, help="for each description [s] (60)"
    )
    sub.add_argument("--out", metavar="FILE", help="write a line for each as csv")


def run(options: argparse.Namespace) -> int:
    """Try all and print the table.  Returns 0, or 1 if a judgement failed or there is a defect."""
    from ..common.files import check_path
    from ..laboratory.corpus.run_corpus import corpus

    out = None if options.out is None else check_path(options.out, (".csv",))
    found = corpus(
        options.folders,
        robots=options.robots,
        duration=options.time,
        patience=options.patience,
        out=out,
        tried=_progress,
    )
    if sys.stderr.isatty():
        sys.stderr.write("\r\033[K")
    print(found)
    if out is not None:
        print(f"written to {out}")
    return 0 if found.passed else 1


def _progress(entry: Entry, number: int, of: int) -> None:
    """Show how far it is on a terminal, and elsewhere each that failed."""
    if sys.stderr.isatty():
        sys.stderr.write(f"\r\033[K{number} of {of}: {entry.file[-60:]}")
        sys.stderr.flush()
    if entry.outcome in ("FAILED", "error"):
        start = "\r\033[K" if sys.stderr.isatty() else ""
        print(f"{start}{entry.outcome}: {entry.file}: {entry.reason}", file=sys.stderr)
