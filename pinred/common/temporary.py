"""Temporary files next to their final location, and removal of files left by killed processes.

A process locks its temporary file while it writes.  The lock ends with the process, so a file
that can be locked belongs to no running process and may be removed.
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
    """A new, locked temporary file.

    Attributes:
        folder: Descriptor of its folder.
        name: Name in this folder.
        descriptor: Descriptor of the open file.
    """

    folder: int
    name: str
    descriptor: int

    def become(self, name: str) -> None:
        """Rename the file to its final name.  Raises OSError."""
        os.replace(self.name, name, src_dir_fd=self.folder, dst_dir_fd=self.folder)


@contextmanager
def temporary(folder: int, mode: int = 0o666) -> Iterator[Temporary]:
    """Create a temporary file in a folder, and remove it at the end unless it was renamed.

    Args:
        folder: Descriptor of the folder.
        mode: Permissions of the file, before the process's umask applies.
    Yields:
        The file.
    Raises:
        OSError: The file cannot be created.
    """
    sweep(folder)
    while True:
        name = f".pinred-{secrets.token_hex(8)}.tmp"
        descriptor = os.open(
            name, os.O_RDWR | os.O_CREAT | os.O_EXCL | _NO_LINKS, mode, dir_fd=folder
        )
        with suppress(OSError):  # without file locks, no process sweeps this file system
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        if os.fstat(descriptor).st_nlink:
            break
        os.close(descriptor)  # another process removed it before it was locked
    try:
        yield Temporary(folder, name, descriptor)
    finally:
        with suppress(OSError):
            os.unlink(name, dir_fd=folder)
        os.close(descriptor)


def sweep(folder: int) -> None:
    """Remove the temporary files of ended processes in a folder."""
    with suppress(OSError):
        readable = os.open(".", os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC, dir_fd=folder)
        try:
            names = [name for name in os.listdir(readable) if _NAME.fullmatch(name)]
        finally:
            os.close(readable)
        for name in names:
            _remove_if_unlocked(folder, name)


def _remove_if_unlocked(folder: int, name: str) -> None:
    with suppress(OSError):
        descriptor = os.open(name, os.O_RDWR | os.O_NONBLOCK | _NO_LINKS, dir_fd=folder)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            os.unlink(name, dir_fd=folder)
        finally:
            os.close(descriptor)
