"""Recorded joint data as one cycle of a gait.

A .csv file has a header line with `t` and the joint names, then one line per time. A .npz file has
the arrays `t` (T,) and `x` (T, m), as a saved Trajectory does. The last line repeats the first, one
period later.
"""

from __future__ import annotations

import csv
import zlib
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from ...common.arrays import Array, as_floats
from ...common.errors import InputError, LoadError
from ...common.names import quoted_path

_DAMAGED = (BadZipFile, zlib.error, csv.Error, EOFError, NotImplementedError, MemoryError)
_CLOSED = 1e-6  # largest gap at the end of the data, relative to the range of the joints


def points_in(path: Path) -> tuple[Array, Array]:
    """Read the times and shapes of one cycle.

    Args:
        path: A .csv or .npz file.
    Returns:
        Times (T,) and shapes (T, m); the last shape equals the first.
    Raises:
        LoadError: The file cannot be read.
        InputError: The data is not one closed cycle.
    """
    name = quoted_path(path)
    if path.suffix not in (".csv", ".npz"):
        raise InputError(f"joint data is read from .csv or .npz files, got {name}")
    try:
        _refuse_pipe(path)
        t, x = _csv(path) if path.suffix == ".csv" else _npz(path)
    except (OSError, ValueError, KeyError, *_DAMAGED) as error:
        raise LoadError(f"cannot read joint data from {name}: {error}") from None
    if t.ndim != 1 or x.ndim != 2 or len(t) != len(x) or len(t) < 4:
        raise InputError(f"{name} must contain times (T,) and shapes (T, m), with T at least 4")
    if not (np.isfinite(t).all() and np.isfinite(x).all() and (np.diff(t) > 0.0).all()):
        raise InputError(f"times in {name} must increase, and all numbers must be finite")
    gap = np.abs(x[-1] - x[0])
    extent = np.ptp(x, axis=0)
    if (gap > _CLOSED * max(float(extent.max()), 1e-300)).any():
        raise InputError(
            f"the data in {name} is not a closed path: it starts at {x[0]} and ends at {x[-1]}"
        )
    return t, x


def _refuse_pipe(path: Path) -> None:
    """Raise ValueError unless a path is a regular file or missing; pipes wait for their writer."""
    if path.exists() and not path.is_file():
        raise ValueError("it is not a regular file")


def _csv(path: Path) -> tuple[Array, Array]:
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    if not rows or not rows[0] or rows[0][0].strip() != "t":
        raise ValueError("the first line must contain t and the names of the joints")
    data = as_floats([[float(cell) for cell in row] for row in rows[1:] if row], "the lines")
    if data.ndim != 2:
        raise ValueError("there are no lines of numbers")
    return data[:, 0], data[:, 1:]


def _npz(path: Path) -> tuple[Array, Array]:
    with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
        return as_floats(file["t"], "t"), as_floats(file["x"], "x")
