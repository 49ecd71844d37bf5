"""Measurements of accuracy on disk: one csv file in which every row says all about itself.

A scene is measured in one run, so its rows are written together: whoever is interrupted has
all scenes that were finished, and goes on with the next.  Every row names its run, and what
is read back keeps runs apart, so that no ratio is ever taken between two of them.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path

from ...common.errors import InputError, LoadError
from ...common.files import write_table
from .work_precision import Point, WorkPrecision

NAME = "accuracy.csv"
_POINT = tuple(field.name for field in fields(Point))
_ABOUT = (
    *("effort", "run", "problem", "description", "joints", "duration"),
    *("reference_error", "reference"),
)
COLUMNS = (*_ABOUT, "about", *_POINT, "error")


def write_record(path: Path, effort: str, results: Iterable[WorkPrecision]) -> None:
    """Write results to a file, whole or not at all.

    effort: what they were measured with.  Raises OutputError.
    """
    rows: list[dict[str, object]] = []
    for found in results:
        head = {name: getattr(found, name) for name in _ABOUT[1:]} | {"effort": effort}
        for point in found.points:
            row = {name: getattr(point, name) for name in _POINT}
            about = found.about[point.method]
            rows.append({**head, **row, "about": about, "error": point.error})
        rows += [
            {**head, "method": method, "failure": line} for method, line in found.missing.items()
        ]
    write_table(path, COLUMNS, rows)


def read_record(path: Path, effort: str | None = None) -> list[WorkPrecision]:
    """Return the results in a file, in its order.

    effort: what they must have been measured with, if anything.  Raises LoadError if it
    cannot be read or is no such record, InputError if another effort was made.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise LoadError(f"cannot read table '{path}': {error}") from None
    groups: dict[tuple[str, str], list[dict[str, str]]] = {}
    try:
        for row in rows:
            groups.setdefault((row["problem"], row["run"]), []).append(row)
        others = {row["effort"] for row in rows} - {effort}
        results = [_result(group) for group in groups.values()]
    except (KeyError, ValueError, TypeError) as error:
        told = f"it has no column {error}" if isinstance(error, KeyError) else error
        raise LoadError(
            f"'{path}' is not accuracy.csv of `pinred bench accuracy`: {told}"
        ) from None
    if effort is not None and others:
        raise InputError(
            f"'{path}' was measured as '{min(others)}', not '{effort}': "
            "give another folder, or the same options"
        )
    return results


def _result(rows: list[dict[str, str]]) -> WorkPrecision:
    head = rows[0]
    there = [row for row in rows if row["tolerance"]]
    return WorkPrecision(
        problem=head["problem"],
        description=head["description"],
        joints=int(head["joints"]),
        duration=float(head["duration"]),
        reference_error=float(head["reference_error"]),
        reference=head["reference"],
        about={row["method"]: row["about"] for row in there},
        points=tuple(_point(row) for row in there),
        missing={row["method"]: row["failure"] for row in rows if not row["tolerance"]},
        run=head["run"],
    )


def _point(row: dict[str, str]) -> Point:
    numbers = {name: float(row[name]) for name in _POINT if name not in ("method", "failure")}
    if not math.isfinite(numbers["tolerance"]):
        raise ValueError(f"a tolerance of {row['tolerance']}")
    return Point(method=row["method"], failure=row["failure"], **numbers)
