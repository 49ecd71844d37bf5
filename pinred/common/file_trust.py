"""Checks that no other user can write a file or folder of the kernel cache."""

from __future__ import annotations

import os
import stat
from contextlib import suppress
from pathlib import Path

_OTHERS = stat.S_IWGRP | stat.S_IWOTH


def find_distrust(status: os.stat_result) -> str:
    """Return why another user could have written a file or folder, or "" if none could."""
    if status.st_uid != os.geteuid():
        return f"belongs to user {status.st_uid}"
    if status.st_mode & _OTHERS:
        return f"can be written by others (mode {stat.S_IMODE(status.st_mode):04o})"
    return ""


def find_open_parent(folder: Path) -> str:
    """Return a warning about a parent folder that other users can replace, or "" without one.

    A folder with the sticky bit, such as /tmp, is safe: users cannot move each other's files there.
    """
    for above in folder.absolute().parents:
        with suppress(OSError):
            status = above.stat()
            if status.st_mode & stat.S_IWOTH and not status.st_mode & stat.S_ISVTX:
                return (
                    f"'{above}', where everyone can write (mode "
                    f"{stat.S_IMODE(status.st_mode):04o}): others can replace the cache "
                    "folder, and its entries are then not used; set PINRED_CACHE_DIR to a "
                    "private folder"
                )
    return ""
