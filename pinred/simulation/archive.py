"""Archives of plain arrays (.npz), whose sizes are checked before their contents are read.

A few bytes of an archive, or of the header of an array, can stand for gigabytes.
"""

from __future__ import annotations

import os
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from ..common.errors import LoadError
from ..common.paths import is_file
from ..common.plain_names import plain_path, quoted, quoted_path

MOST_BYTES = 1_000_000_000  # Largest accepted size of all arrays together [bytes].
_MOST_ARRAYS = 100
_READ_ERRORS = (
    ValueError, OSError, EOFError, KeyError, TypeError, NotImplementedError, SyntaxError,
    AttributeError, MemoryError, OverflowError, RuntimeError, zipfile.BadZipFile, zlib.error,
    struct.error,
)  # fmt: skip


def read_arrays(path: Path) -> dict[str, Any]:
    """Return the arrays of a .npz file by name.

    Args:
        path: Path of the file.
    Returns:
        The arrays; Python objects are never read.
    Raises:
        LoadError: The file is missing, unreadable, too large, or contains other data.
    """
    name = quoted_path(path)
    if not is_file(path):
        raise LoadError(f"no such file: {plain_path(path)}")
    if not os.access(path, os.R_OK):
        raise LoadError(f"{name} cannot be read: permission denied")
    if path.stat().st_size > MOST_BYTES:
        raise LoadError(f"{name} is larger than {MOST_BYTES // 10**6} MB")
    if not zipfile.is_zipfile(path):
        raise LoadError(f"{name} is no .npz file of plain arrays: it is no archive, or cut off")
    try:
        with zipfile.ZipFile(path) as archive:
            _check_sizes(name, archive)
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            return {key: file[key] for key in file.files}
    except _READ_ERRORS:  # NumPy's messages advise options that users of pinred do not have.
        raise LoadError(
            f"{name} is no .npz file of plain arrays: its contents are damaged, "
            "or made of Python objects, which are not read"
        ) from None


def _check_sizes(name: str, archive: zipfile.ZipFile) -> None:
    """Check the stated sizes of an archive.

    Args:
        name: The file in messages.
        archive: The open archive.
    Raises:
        LoadError: The archive is too large, or has other members than arrays.
        ValueError: The header of an array does not match its size.
    """
    members = archive.infolist()
    if len(members) > _MOST_ARRAYS:
        raise LoadError(f"{name} has {len(members)} arrays, more than {_MOST_ARRAYS}")
    for member in members:
        if not member.filename.endswith(".npy"):
            raise LoadError(
                f"{name} is no .npz file of plain arrays: {quoted(member.filename)} is none"
            )
    total = sum(member.file_size for member in members)
    if total > MOST_BYTES:
        raise LoadError(
            f"{name} would take {total / 1e9:.3g} GB unpacked, more than {MOST_BYTES / 1e9:g}; "
            "record fewer times"
        )
    for member in members:
        with archive.open(member) as stream:
            version = np.lib.format.read_magic(stream)
            read_header = {
                (1, 0): np.lib.format.read_array_header_1_0,
                (2, 0): np.lib.format.read_array_header_2_0,
            }[version]
            shape, _, dtype = read_header(stream)
            size = dtype.itemsize
            for length in shape:
                size *= length
            if (
                dtype.hasobject
                or min(shape, default=0) < 0
                or stream.tell() + size != (member.file_size)
            ):
                raise ValueError
