"""One entry of the object cache: a payload with its key and the signature of the user."""

from __future__ import annotations

import hmac
import os
import stat
import struct
from contextlib import suppress
from typing import BinaryIO

from .file_trust import find_distrust
from .files import temporary
from .signing_key import signing_key

_VERSION = 2
_MAGIC = b"pinred\x00\n"
_HEADER = struct.Struct("<8sI64sQ")  # magic, version, key, length of the payload
_SIGNATURE = 32  # bytes of the HMAC-SHA256 of header and payload, stored between them
ENTRY_HEAD = _HEADER.size + _SIGNATURE  # bytes of an entry before its payload


class DistrustError(Exception):
    """A cache entry cannot be trusted and must not be used; the message states the reason."""


def read_entry(folder: int, name: str, key: str) -> bytes:
    """Read the payload of an entry and update its time of use.

    Args:
        folder: Descriptor of the folder.
        name: Name of the entry's file.
        key: Key of the entry.
    Returns:
        The payload.
    Raises:
        FileNotFoundError: The entry does not exist.
        DistrustError: The entry must not be used.
    """
    # Do not follow symbolic links, and do not block on named pipes.
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    descriptor = os.open(name, flags, dir_fd=folder)
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise DistrustError("it is not a regular file")
        if why := find_distrust(status):
            raise DistrustError(f"it {why}")
        with os.fdopen(descriptor, "rb", closefd=False) as file:
            payload = _verify(file, status.st_size, key)
        with suppress(OSError):
            os.utime(descriptor)
    finally:
        os.close(descriptor)
    return payload


def _verify(file: BinaryIO, size: int, key: str) -> bytes:
    """Return the payload of an open entry.  Raises DistrustError unless all checks pass."""
    head = file.read(_HEADER.size)
    if len(head) < _HEADER.size:
        raise DistrustError("it is truncated")
    magic, form, stored_key, length = _HEADER.unpack(head)
    if magic != _MAGIC:
        raise DistrustError("it was not written by pinred")
    if form != _VERSION:
        raise DistrustError(f"its format is {form}, not {_VERSION}")
    if stored_key != key.encode():
        raise DistrustError("it contains the object of another key")
    if length != size - _HEADER.size - _SIGNATURE:
        raise DistrustError("its length differs from the length in its header")
    signature, payload = file.read(_SIGNATURE), file.read(length)
    if not hmac.compare_digest(signature, _signature(head, payload)):
        raise DistrustError("its signature is not this user's, or it is damaged")
    return payload


def _signature(header: bytes, payload: bytes) -> bytes:
    return hmac.digest(signing_key(), header + payload, "sha256")


def write_entry(folder: int, name: str, key: str, payload: bytes) -> None:
    """Write an entry under a temporary name, then rename it once it is complete on disk.

    Args:
        folder: Descriptor of the folder.
        name: Name of the entry's file.
        key: Key of the entry.
        payload: The payload.
    Raises:
        OSError: The file cannot be written.
    """
    head = _HEADER.pack(_MAGIC, _VERSION, key.encode(), len(payload))
    with temporary(folder, 0o600) as file_at:
        with os.fdopen(file_at.descriptor, "wb", closefd=False) as file:
            file.write(head + _signature(head, payload) + payload)
            file.flush()
            os.fsync(file_at.descriptor)
        file_at.become(name)
