"""Atomic writing of files: complete or not at all."""

from __future__ import annotations

import csv
import io
import os
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from .errors import InputError, OutputError
from .plain_names import quoted_path
from .temporary import temporary

DATA = (".npz", ".csv")
FIGURES = (".png", ".pdf", ".svg")
_PATH = getattr(os, "O_PATH", os.O_RDONLY)  # opens folders without read permission, too


def check_path(path: str | Path, suffixes: Sequence[str] = DATA) -> Path:
    """Check that a file can be written at a path.

    Args:
        path: Name of the file.
        suffixes: Allowed suffixes.
    Returns:
        The path.
    Raises:
        InputError: The name is invalid, its folder is missing, or another object has this name.
        OutputError: The folder or an existing file is read-only.
    """
    if not isinstance(path, (str, os.PathLike)) or "\0" in str(path):
        raise InputError(f"path must be the name of a file, got {path!r}")
    path = Path(path)
    name = quoted_path(path)
    if path.suffix not in suffixes:
        raise InputError(f"cannot write {name}: the suffix must be {' or '.join(suffixes)}")
    try:
        if not path.parent.is_dir():
            raise InputError(f"cannot write {name}: there is no folder {quoted_path(path.parent)}")
        if path.exists():
            _check_old(path, name)
        # Try to write now, so that a long simulation does not fail at its end.
        with _folder(path) as folder, temporary(folder):
            return path
    except OSError as error:
        raise OutputError(f"cannot write {name}: {error.strerror or error}") from None


def _check_old(path: Path, name: str) -> None:
    """Reject a path whose present content would be lost or is protected."""
    mode = path.stat().st_mode
    if stat.S_ISDIR(mode):
        raise InputError(f"cannot write {name}: it is a folder")
    if not stat.S_ISREG(mode):
        kind = "a FIFO" if stat.S_ISFIFO(mode) else "not a plain file"
        raise InputError(f"cannot write {name}: it is {kind}, which a file would replace")
    # Rename would replace a read-only file, and root may write any file, so check the mode.
    if not mode & 0o222 or not os.access(path, os.W_OK):
        raise OutputError(f"cannot write {name}: there is such a file, and it is read-only")


@contextmanager
def _folder(path: Path) -> Iterator[int]:
    """Open the folder of a path and yield its descriptor."""
    folder = os.open(path.parent, _PATH | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        yield folder
    finally:
        os.close(folder)


def write_atomic(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Write a file under a temporary name in its folder, then rename it.

    Temporary files of killed processes in this folder are removed.

    Args:
        path: Name of the file.
        write: Function that writes the content to a binary file.
    Raises:
        OutputError: The file cannot be written; an older file of this name is unchanged.
    """
    try:
        with _folder(path) as folder, temporary(folder) as file_at:
            with os.fdopen(file_at.descriptor, "wb", closefd=False) as file:
                write(file)
            file_at.become(path.name)
    except OSError as error:
        raise OutputError(f"cannot write {quoted_path(path)}: {error.strerror or error}") from error


def write_table(path: Path, columns: Sequence[str], rows: Iterable[Mapping[str, object]]) -> None:
    """Write a table as a csv file.

    Args:
        path: Name of the file.
        columns: Names of the columns, in order.
        rows: Cells of each row by column name.
    Raises:
        OutputError: The file cannot be written.
    """
    text = io.StringIO()
    table = csv.DictWriter(text, columns, lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    write_atomic(path, lambda file: file.write(text.getvalue().encode()))
