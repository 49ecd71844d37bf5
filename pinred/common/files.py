"""Files that are written whole or not at all."""

from __future__ import annotations

import csv
import io
import os
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import BinaryIO

from .errors import InputError, OutputError


def check_path(path: str | Path, suffixes: Sequence[str] = (".npz", ".csv")) -> Path:
    """Return `path` if a file can be written there.  Raises InputError or OutputError if not."""
    if not isinstance(path, (str, os.PathLike)) or "\0" in str(path):
        raise InputError(f"path must be the name of a file, got {path!r}")
    path = Path(path)
    if path.suffix not in suffixes:
        raise InputError(f"cannot write '{path}': the suffix must be {' or '.join(suffixes)}")
    try:
        if path.is_dir():
            raise InputError(f"cannot write '{path}': it is a folder")
        if not path.parent.is_dir():
            raise InputError(f"cannot write '{path}': there is no folder '{path.parent}'")
        # Try now what the end of a long simulation will need.
        with tempfile.NamedTemporaryFile(dir=path.parent, prefix=f".{path.name}."):
            return path
    except OSError as error:
        raise OutputError(f"cannot write '{path}': {error.strerror or error}") from None


def write_atomic(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Write a file under a temporary name beside `path` and move it there when complete.

    Raises OutputError if that fails.
    """
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "wb") as file:
                write(file)
            umask = os.umask(0)  # mkstemp makes the file private; give it the usual rights
            os.umask(umask)
            os.chmod(name, 0o666 & ~umask)
            os.replace(name, path)
        except BaseException:
            os.unlink(name)
            raise
    except OSError as error:
        raise OutputError(f"cannot write '{path}': {error.strerror or error}") from error


def write_table(path: Path, columns: Sequence[str], rows: Iterable[Mapping[str, object]]) -> None:
    """Write rows by their columns as csv, whole or not at all.  Raises OutputError."""
    text = io.StringIO()
    table = csv.DictWriter(text, columns, lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    write_atomic(path, lambda file: file.write(text.getvalue().encode()))
