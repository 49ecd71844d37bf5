"""The user's signing key for entries of the kernel cache.

Another user who can write into the cache can forge a checksum, but not a signature.  The key is
stored in the user's data folder, which no other user can read.
"""

from __future__ import annotations

import hmac
import os
import secrets
import stat
import warnings
from contextlib import suppress
from functools import cache
from pathlib import Path
from threading import Lock

from platformdirs import user_data_path

from .errors import CacheWarning
from .files import temporary

TEMPORARY = "0" * 16  # fingerprint of a signing key that could not be stored
_NAME = "cache_key"
_LOCK = Lock()
_SIZE = 32  # length of the key [bytes]
_NOT_OWNERS = stat.S_IRWXG | stat.S_IRWXO


def signing_key() -> bytes:
    """Return the user's signing key, created at the first use.

    A key file that others can read or write is replaced with a CacheWarning.  If no key can be
    stored, a CacheWarning is issued and this process uses a temporary key.
    """
    with _LOCK:
        return _load_key(user_data_path("pinred"))[0]


def fingerprint() -> str:
    """Return 16 hexadecimal digits that identify the signing key without revealing it.

    All keys that could not be stored share the fingerprint TEMPORARY, so that processes without a
    stored key overwrite each other's entries instead of filling the cache.
    """
    key = signing_key()
    with _LOCK:
        is_stored = _load_key(user_data_path("pinred"))[1]
    return hmac.digest(key, b"fingerprint", "sha256").hex()[:16] if is_stored else TEMPORARY


@cache
def _load_key(path: Path) -> tuple[bytes, bool]:
    """Return the key, and whether it is stored in a folder."""
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        folder = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            return _read_key(folder) or _create_key(folder, path), True
        finally:
            os.close(folder)
    except OSError as error:
        _warn(
            f"the key of the kernel cache cannot be stored in '{path}' "
            f"({error.strerror or error}), so other processes compile again; "
            "set XDG_DATA_HOME to a private folder"
        )
        return secrets.token_bytes(_SIZE), False


def _read_key(folder: int) -> bytes | None:
    """Return the key stored in a folder, or None if there is no private key file."""
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    try:
        descriptor = os.open(_NAME, flags, dir_fd=folder)
    except FileNotFoundError:
        return None
    except OSError:  # the name is a symbolic link
        return None
    try:
        status = os.fstat(descriptor)
        private = status.st_uid == os.geteuid() and not status.st_mode & _NOT_OWNERS
        if not stat.S_ISREG(status.st_mode) or not private or status.st_size != _SIZE:
            return None
        return os.read(descriptor, _SIZE)
    finally:
        os.close(descriptor)


def _create_key(folder: int, path: Path) -> bytes:
    """Create a key in a folder; if another process was faster, return its key instead."""
    if os.access(_NAME, os.F_OK, dir_fd=folder, follow_symlinks=False):
        _warn(f"'{path / _NAME}' was not private: it is replaced, and kernels are compiled again")
        os.unlink(_NAME, dir_fd=folder)
    with temporary(folder, 0o600) as file:
        os.write(file.descriptor, secrets.token_bytes(_SIZE))
        os.fsync(file.descriptor)
        with suppress(FileExistsError):  # another process was faster, and its key is used
            os.link(file.name, _NAME, src_dir_fd=folder, dst_dir_fd=folder)
    key = _read_key(folder)
    if key is None:
        raise OSError(f"'{_NAME}' in this folder is not a private file of this user")
    return key


def _warn(text: str) -> None:
    warnings.warn(text, CacheWarning, stacklevel=6)
