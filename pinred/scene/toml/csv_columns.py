"""Columns of numbers from csv files, parsed as text and validated cell by cell."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...common.arrays import Array
from ...common.errors import InputError, LoadError
from ...common.names import quoted_path
from .file_place import shown, unknown

LARGEST = 10_000_000  # largest accepted size of a file [byte]


def read_text(path: Path, what: str) -> str:
    """Return the text of a file.

    Args:
        path: The file.
        what: Kind of file in messages.
    Returns:
        The text.
    Raises:
        LoadError: The file is missing, too large, or not UTF-8.
    """
    try:
        if not path.is_file():
            raise LoadError(f"no such {what}: {quoted_path(path)}")
        with path.open("rb") as file:
            raw = file.read(LARGEST + 1)
        if len(raw) > LARGEST:
            raise LoadError(f"{what} {quoted_path(path)} has more than {LARGEST} bytes")
        return raw.decode("utf-8")
    except UnicodeDecodeError as error:
        raise LoadError(
            f"{what} {quoted_path(path)} is not UTF-8 text, at byte {error.start}"
        ) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise LoadError(f"cannot read {what} {quoted_path(path)}: {reason}") from None


def read_columns(path: Path, columns: Sequence[str | int]) -> Array:
    """Return columns of a csv file.

    The first line is a header if one of its cells is not a number.

    Args:
        path: The file.
        columns: Column names in the header, or column indices from 0.
    Returns:
        Values of the columns, (rows, len(columns)).
    Raises:
        LoadError: The file cannot be read.
        InputError: A column is missing or a cell is not a number.
    """
    text = read_text(path, "csv file")
    try:
        lines = [
            (reader.line_num, [cell.strip() for cell in row])
            for reader in [csv.reader(io.StringIO(text, newline=""), strict=True)]
            for row in reader
            if any(cell.strip() for cell in row)
        ]
    except csv.Error as error:
        raise InputError(f"{quoted_path(path)} is not a csv file: {error}") from None
    if not lines:
        raise InputError(f"{quoted_path(path)} is empty")
    first = lines[0][1]
    header = first if any(_float(cell) is None for cell in first) else []
    chosen = [_index(column, header, len(first), path) for column in columns]
    rows = lines[1:] if header else lines
    if not rows:
        raise InputError(f"{quoted_path(path)} has no numbers below its header")
    return np.array([[_cell(row, k, line, path) for k in chosen] for line, row in rows])


def _index(column: str | int, header: list[str], count: int, path: Path) -> int:
    if isinstance(column, str):
        if column not in header:
            said = unknown(column, "column", header, "the columns are")
            raise InputError(
                f"{quoted_path(path)}: {said if header else 'there is no header with names'}"
            )
        if header.count(column) > 1:
            raise InputError(f"{quoted_path(path)} has two columns {shown(column)}")
        return header.index(column)
    if column >= count:
        raise InputError(
            f"{quoted_path(path)} has {count} columns, so column {column} (counted from 0) is "
            "missing"
        )
    return column


def _cell(row: list[str], k: int, line: int, path: Path) -> float:
    where = f"{quoted_path(path)}, line {line}, column {k}"
    if k >= len(row):
        raise InputError(f"{where}: there are only {len(row)} columns")
    value = _float(row[k])
    if value is None or not math.isfinite(value):
        raise InputError(f"{where}: must be a finite number, got {shown(row[k])}")
    return value


def _float(cell: str) -> float | None:
    try:
        return None if "_" in cell else float(cell)
    except ValueError:
        return None
