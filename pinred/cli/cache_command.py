"""`pinred cache`: list or remove the compiled code on disk, or compile ahead of use."""

from __future__ import annotations

import argparse

_LISTED = 20  # largest number of objects that are listed


def add_arguments(sub: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    sub.add_argument(
        "warm", nargs="*", metavar="warm ROBOT", help="compile what calls on a robot need"
    )
    sub.add_argument("--clear", action="store_true", help="remove all kernels and integrators")


def run(arguments: argparse.Namespace) -> int:
    """List the objects, remove them, or compile the code of a robot.  Returns 0."""
    from ..common.object_cache import ObjectCache

    if arguments.warm:
        _warm(arguments.warm)
        return 0
    cache = ObjectCache()
    if arguments.clear:
        print(f"{cache.clear()} compiled objects removed from {cache.folder}")
        return 0
    entries = cache.entries()
    size = sum(entry.size for entry in entries)
    print(
        f"{len(entries)} compiled objects, {size / 1e6:.2f} MB of {cache.limit / 1e6:.0f}, "
        f"in {cache.folder}"
    )
    for entry in entries[: -_LISTED - 1 : -1]:  # The most recently used object comes first.
        print(f"  {entry.key[:16]}  {entry.size / 1e3:8.1f} kB")
    if len(entries) > _LISTED:
        print(f"  … and {len(entries) - _LISTED} more")
    return 0


def _warm(words: list[str]) -> None:
    """Compile the code of a robot, and print what was prepared."""
    from ..common.errors import InputError
    from ..system.load import load
    from .warm_caches import warm_caches

    if words[0] != "warm" or len(words) != 2:
        raise InputError(f"expected `pinred cache warm ROBOT`, got {' '.join(words)!r}")
    system = load(words[1])
    total = 0.0
    for call, seconds in warm_caches(system):
        print(f"{seconds:7.2f} s  {call}", flush=True)
        total += seconds
    print(f"{total:7.2f} s in all; further processes find the code of '{system.name}' in the cache")
