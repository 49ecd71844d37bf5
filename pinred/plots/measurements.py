"""What `pinred bench accuracy` wrote, read back."""

from __future__ import annotations

import csv
from dataclasses import fields
from pathlib import Path

import numpy as np

from ..bench.accuracy import Point, WorkPrecision
from ..csv_table import read_text
from ..errors import LoadError

_TEXT = ("method", "failure")


def read_measurements(path: str | Path) -> list[WorkPrecision]:
    """Return the measurements in accuracy.csv, a result a problem.

    What the file does not hold is unknown: the number of joints is 0, the duration NaN, and so
    is the error of the references where there is no column reference_error.
    Raises LoadError if it cannot be read or holds something else.
    """
    path = Path(path)
    rows = list(csv.DictReader(read_text(path, "table").splitlines()))
    names = [field.name for field in fields(Point)]
    has = set(rows[0]) if rows else set()
    missing = [name for name in ("problem", *names) if name not in has]
    if missing:
        raise LoadError(
            f"'{path}' is not accuracy.csv of `pinred bench accuracy`: it has no '{missing[0]}'"
        )
    found = []
    for problem in dict.fromkeys(row["problem"] for row in rows):
        own = [row for row in rows if row["problem"] == problem]
        try:
            points = tuple(
                Point(**{n: row[n] if n in _TEXT else float(row[n]) for n in names})  # type: ignore[arg-type]
                for row in own
            )
            reference = float(own[0].get("reference_error") or "nan")
        except (TypeError, ValueError) as error:
            raise LoadError(f"'{path}': {error}") from None
        found.append(
            WorkPrecision(
                problem=problem,
                joints=0,
                duration=np.nan,
                reference_error=reference,
                about={point.method: "" for point in points},
                points=points,
            )
        )
    return found
