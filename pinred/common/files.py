"""Files that are written whole or not at all."""

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
_PATH = getattr(os, "O_PATH", os.O_RDONLY)  # of a folder in which one may write, but not look


def check_path(path: str | Path, suffixes: Sequence[str] = DATA) -> Path:
    """Return `path` if a file can be written there.  Raises InputError or OutputError if not."""
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
        # Try now what the end of a long simulation will need.
        with _folder(path) as folder, temporary(folder):
            return path
    except OSError as error:
        raise OutputError(f"cannot write {name}: {error.strerror or error}") from None


def _check_old(path: Path, name: str) -> None:
    """Refuse a path at which something is that would be lost, or is protected."""
    mode = path.stat().st_mode
    if stat.S_ISDIR(mode):
        raise InputError(f"cannot write {name}: it is a folder")
    if not stat.S_ISREG(mode):
        kind = "a FIFO" if stat.S_ISFIFO(mode) else "no plain file"
        raise InputError(f"cannot write {name}: it is {kind}, in whose place a file would come")
    # Nothing keeps a user root from writing, nor anybody from putting another file in its place.
    if not mode & 0o222 or not os.access(path, os.W_OK):
        raise OutputError(f"cannot write {name}: there is such a file, and it is read-only")


@contextmanager
def _folder(path: Path) -> Iterator[int]:
    """Yield a descriptor of the folder of a path."""
    folder = os.open(path.parent, _PATH | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        yield folder
    finally:
        os.close(folder)


def write_atomic(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Write a file under a temporary name beside `path` and move it there when complete.

    What processes that were killed while they wrote there have left is removed.
    Raises OutputError if that fails.
    """
    try:
        with _folder(path) as folder, temporary(folder) as made:
            with os.fdopen(made.descriptor, "wb", closefd=False) as file:
                write(file)
            made.become(path.name)
    except OSError as error:
        raise OutputError(f"cannot write {quoted_path(path)}: {error.strerror or error}") from error


def write_table(path: Path, columns: Sequence[str], rows: Iterable[Mapping[str, object]]) -> None:
    """Write rows by their columns as csv, whole or not at all.  Raises OutputError."""
    text = io.StringIO()
    table = csv.DictWriter(text, columns, lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    write_atomic(path, lambda file: file.write(text.getvalue().encode()))
