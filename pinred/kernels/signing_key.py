"""A secret of the user's own, with which entries of the cache are signed.

Who can write into a cache can write a checksum as well, but not a signature: the key for it
stands in the user's folder for data, not in the cache, and nobody else can read it.
"""

from __future__ import annotations

import os
import secrets
import stat
import warnings
from contextlib import suppress
from functools import cache
from pathlib import Path
from threading import Lock

from platformdirs import user_data_path

from ..common.errors import CacheWarning
from ..common.temporary import temporary

_NAME = "cache_key"
_LOCK = Lock()
_SIZE = 32  # bytes
_NOT_OWNERS = stat.S_IRWXG | stat.S_IRWXO


def signing_key() -> bytes:
    """Return the user's key, made when it is first needed.

    A file that others can read or write is no secret: it is replaced, with a CacheWarning.
    Where none can be kept, there is one for this process alone, and a CacheWarning.
    """
    with _LOCK:
        return _secret(user_data_path("pinred"))


@cache
def _secret(path: Path) -> bytes:
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        folder = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            return _kept(folder) or _made(folder, path)
        finally:
            os.close(folder)
    except OSError as error:
        _warn(
            f"the key for compiled code cannot be kept in '{path}' ({error.strerror or error}): "
            "other processes compile anew what this one keeps"
        )
        return secrets.token_bytes(_SIZE)


def _kept(folder: int) -> bytes | None:
    """Return the key in a folder; None if there is none, or if it is no secret."""
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    try:
        descriptor = os.open(_NAME, flags, dir_fd=folder)
    except FileNotFoundError:
        return None
    except OSError:  # a link
        return None
    try:
        status = os.fstat(descriptor)
        private = status.st_uid == os.geteuid() and not status.st_mode & _NOT_OWNERS
        if not stat.S_ISREG(status.st_mode) or not private or status.st_size != _SIZE:
            return None
        return os.read(descriptor, _SIZE)
    finally:
        os.close(descriptor)


def _made(folder: int, path: Path) -> bytes:
    """Return a new key that is kept in a folder, or the one that another process has just made."""
    if os.access(_NAME, os.F_OK, dir_fd=folder, follow_symlinks=False):
        _warn(f"'{path / _NAME}' was no secret: it is replaced, and kernels are compiled anew")
        os.unlink(_NAME, dir_fd=folder)
    with temporary(folder, 0o600) as made:
        os.write(made.descriptor, secrets.token_bytes(_SIZE))
        os.fsync(made.descriptor)
        with suppress(FileExistsError):  # of two that come at once, the first one's is everyone's
            os.link(made.name, _NAME, src_dir_fd=folder, dst_dir_fd=folder)
    found = _kept(folder)
    if found is None:
        raise OSError(f"'{_NAME}' there is not private")
    return found


def _warn(text: str) -> None:
    warnings.warn(text, CacheWarning, stacklevel=6)
