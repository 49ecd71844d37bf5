"""`pinred cache`: list or remove the compiled kernels on disk."""

from __future__ import annotations

import argparse

_LISTED = 20  # largest number of kernels that are listed


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    sub.add_argument("--clear", action="store_true", help="remove all kernels")


def run(arguments: argparse.Namespace) -> int:
    """List the kernels, or remove them.  Returns 0."""
    from ..common.object_cache import ObjectCache

    cache = ObjectCache()
    if arguments.clear:
        print(f"{cache.clear()} kernels removed from {cache.folder}")
        return 0
    entries = cache.entries()
    size = sum(entry.size for entry in entries)
    print(
        f"{len(entries)} kernels, {size / 1e6:.2f} MB of {cache.limit / 1e6:.0f}, in {cache.folder}"
    )
    for entry in entries[: -_LISTED - 1 : -1]:  # The most recently used kernel comes first.
        print(f"  {entry.key[:16]}  {entry.size / 1e3:8.1f} kB")
    if len(entries) > _LISTED:
        print(f"  … and {len(entries) - _LISTED} more")
    return 0
