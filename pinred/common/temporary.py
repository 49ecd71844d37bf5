"""Temporary files beside those that they become, and the removal of what killed processes left.

A process holds a lock on its temporary file for as long as it writes it.  The lock ends with
the process, whatever ends that; so a file on which a lock can be taken is nobody's any more.
"""

from __future__ import annotations

import fcntl
import os
import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

_NAME = re.compile(r"\.pinred-[0-9a-f]{16}\.tmp")
_NO_LINKS = os.O_NOFOLLOW | os.O_CLOEXEC


@dataclass(frozen=True)
class Temporary:
    """A new file with a lock on it.  folder: descriptor of its folder."""

    folder: int
    name: str
    descriptor: int

    def become(self, name: str) -> None:
        """Move it to its place.  Raises OSError."""
        os.replace(self.name, name, src_dir_fd=self.folder, dst_dir_fd=self.folder)


@contextmanager
def temporary(folder: int, mode: int = 0o666) -> Iterator[Temporary]:
    """Make a temporary file in a folder; it is removed at the end unless it has become another.

    mode: its rights, of which the process's mask takes some.  Raises OSError.
    """
    sweep(folder)
    while True:
        name = f".pinred-{secrets.token_hex(8)}.tmp"
        descriptor = os.open(
            name, os.O_RDWR | os.O_CREAT | os.O_EXCL | _NO_LINKS, mode, dir_fd=folder
        )
        with suppress(OSError):  # a file system without locks: nobody sweeps there, either
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        if os.fstat(descriptor).st_nlink:
            break
        os.close(descriptor)  # it was swept before it was locked
    try:
        yield Temporary(folder, name, descriptor)
    finally:
        with suppress(OSError):
            os.unlink(name, dir_fd=folder)
        os.close(descriptor)


def sweep(folder: int) -> None:
    """Remove the temporary files in a folder whose processes have ended."""
    with suppress(OSError):
        readable = os.open(".", os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC, dir_fd=folder)
        try:
            names = [name for name in os.listdir(readable) if _NAME.fullmatch(name)]
        finally:
            os.close(readable)
        for name in names:
            _remove_if_left(folder, name)


def _remove_if_left(folder: int, name: str) -> None:
    with suppress(OSError):
        descriptor = os.open(name, os.O_RDWR | os.O_NONBLOCK | _NO_LINKS, dir_fd=folder)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            os.unlink(name, dir_fd=folder)
        finally:
            os.close(descriptor)
