"""Checkpoint files: nested values, signed with the user's key.

The compiled loops trust the registers of a run, and states of controllers are pickled. Therefore
only files with the user's own signature are used; see common/files.py.
"""

from __future__ import annotations

import hmac
import json
import struct
from pathlib import Path
from typing import Any, BinaryIO

from ..common.errors import InputError, OutputError
from ..common.files import TEMPORARY, check_path, fingerprint, is_file, signing_key, write_atomic
from ..common.names import quoted_path
from ..common.packed_values import pack, unpack

SUFFIX = ".ckpt"
_MAGIC = b"pinred checkpoint 1\n"
_LENGTH = struct.Struct("<Q")
_SIGNATURE = 32  # bytes of the HMAC-SHA256 of all other bytes, at the end


def check_checkpoint_path(path: str | Path) -> Path:
    """Check that a checkpoint can be written at a path and read by a later process.

    Args:
        path: Name of the file.
    Returns:
        The path.
    Raises:
        OutputError: The signing key cannot be stored, so no other process could read the file.
    """
    checked = check_path(path, (SUFFIX,))
    if fingerprint() == TEMPORARY:
        raise OutputError(
            "checkpoint: expected a data folder that keeps the signing key, so that a later "
            "process can read the checkpoint. Make the home folder writable, or set XDG_DATA_HOME"
        )
    return checked


def write_checkpoint(path: Path, content: dict[str, Any]) -> None:
    """Write nested values atomically.

    Args:
        path: Name of the file.
        content: The values; see common/packed_values.py.
    Raises:
        OutputError: The file cannot be written.
    """
    data, buffers = pack(content)
    head = json.dumps([data, [len(buffer) for buffer in buffers]]).encode()

    def write(file: BinaryIO) -> None:
        signature = hmac.new(signing_key(), digestmod="sha256")
        for block in (_MAGIC, _LENGTH.pack(len(head)), head, *buffers):
            signature.update(block)
            file.write(block)
        file.write(signature.digest())

    write_atomic(path, write)


def read_checkpoint(path: Path) -> dict[str, Any] | None:
    """Read a checkpoint.

    Args:
        path: Name of the file.
    Returns:
        The values; None if there is no file.
    Raises:
        InputError: The file is not a complete checkpoint of this user.
    """
    if not is_file(path):
        return None
    try:
        content = memoryview(path.read_bytes())
    except OSError as error:
        raise InputError(f"checkpoint: cannot read {quoted_path(path)}: {error.strerror}") from None
    if content[: len(_MAGIC)] != _MAGIC:
        raise InputError(_refuse(path, "was not written as a checkpoint by this version of pinred"))
    signed, signature = content[:-_SIGNATURE], content[-_SIGNATURE:]
    if not hmac.compare_digest(signature, hmac.digest(signing_key(), signed, "sha256")):
        why = "is truncated or damaged, or was written with the key of another data folder"
        raise InputError(_refuse(path, why))
    at = len(_MAGIC) + _LENGTH.size
    (size,) = _LENGTH.unpack(signed[len(_MAGIC) : at])
    data, lengths = json.loads(bytes(signed[at : at + size]))
    at, buffers = at + size, []
    for length in lengths:
        buffers.append(signed[at : at + length])
        at += length
    values: dict[str, Any] = unpack(data, buffers)
    return values


def _refuse(path: Path, why: str) -> str:
    return (
        f"checkpoint: expected a checkpoint of this user, but {quoted_path(path)} {why}. Choose "
        "another name, or delete the file to start again"
    )
