"""`pinred corpus`: load, simulate and compare all robot descriptions in some folders."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from typing import TYPE_CHECKING

from .command_options import add_options, option_adder

if TYPE_CHECKING:
    from ..laboratory.corpus.corpus_entry import Entry

_DURATION = 0.5  # default duration of a motion [s]


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    from ..scene.scene_options import SCENE_OPTIONS

    text = "folders with URDF, MJCF and SDF files"
    sub.add_argument("folders", nargs="*", metavar="FOLDER", help=text)
    add = option_adder(sub)
    add("--robots", "include the robots of `pinred robots`")
    add_options(sub, {"duration": replace(SCENE_OPTIONS["duration"], default=f"{_DURATION:g}")})
    sub.set_defaults(duration=_DURATION)
    add("--patience S", "time limit for each description [s]", float, 60.0)
    add("--out FILE", "write the table as csv")


def run(arguments: argparse.Namespace) -> int:
    """Process all descriptions and print a table.  Returns 1 for a failed comparison, else 0."""
    from ..common.files import check_path
    from ..laboratory.corpus.run_corpus import corpus

    out = None if arguments.out is None else check_path(arguments.out, (".csv",))
    result = corpus(
        arguments.folders,
        robots=arguments.robots,
        duration=arguments.duration,
        patience=arguments.patience,
        out=out,
        tried=_progress,
    )
    if sys.stderr.isatty():
        sys.stderr.write("\r\033[K")
    print(result)
    if out is not None:
        print(f"written to {out}")
    return 0 if result.passed else 1


def _progress(entry: Entry, number: int, of: int) -> None:
    """Show a progress line on a terminal, and a line for each failure everywhere."""
    if sys.stderr.isatty():
        sys.stderr.write(f"\r\033[K{number} of {of}: {entry.file[-60:]}")
        sys.stderr.flush()
    if entry.outcome in ("FAILED", "error"):
        start = "\r\033[K" if sys.stderr.isatty() else ""
        print(f"{start}{entry.outcome}: {entry.file}: {entry.reason}", file=sys.stderr)
