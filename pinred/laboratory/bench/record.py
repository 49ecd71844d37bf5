"""Accuracy benchmarks on disk: one csv file whose rows are self-contained.

The rows of a scene are written together. An interrupted benchmark keeps all completed scenes and
can continue with the next scene. Every row names its run. Reading keeps runs separate, so that
ratios never compare times of different runs.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path

from ...common.argument_kinds import checks_arguments
from ...common.errors import InputError, LoadError
from ...common.files import read_plain_file, write_table
from ...common.names import quoted_path
from .work_precision import Point, WorkPrecision

NAME = "accuracy.csv"
_MOST_BYTES = 10**8
_POINT = tuple(field.name for field in fields(Point))
_ABOUT = (
    *("effort", "run", "problem", "description", "joints", "duration"),
    *("reference_error", "reference"),
)
COLUMNS = (*_ABOUT, "about", *_POINT, "error")


@checks_arguments
def write_record(path: Path, effort: str, results: Iterable[WorkPrecision]) -> None:
    """Write results to a csv file; on failure an existing file is kept.

    Args:
        path: The file.
        effort: Name of the time budget (Effort) of the measurement.
        results: Results of `bench_accuracy`.
    Raises:
        OutputError: The file cannot be written.
    """
    rows: list[dict[str, object]] = []
    for result in results:
        head = {name: getattr(result, name) for name in _ABOUT[1:]} | {"effort": effort}
        for point in result.points:
            row = {name: getattr(point, name) for name in _POINT}
            about = result.about[point.method]
            rows.append({**head, **row, "about": about, "error": point.error})
        rows += [
            {**head, "method": method, "failure": line} for method, line in result.missing.items()
        ]
    write_table(path, COLUMNS, rows)


@checks_arguments
def read_record(path: Path, effort: str | None = None) -> list[WorkPrecision]:
    """Read the results from a csv file, in the order of the file.

    Args:
        path: The file.
        effort: Required effort of the measurement; None accepts any effort.
    Returns:
        The results.
    Raises:
        LoadError: The file cannot be read, or is not a record of `bench accuracy`.
        InputError: The file was measured with another effort.
    """
    name, content = quoted_path(path), read_plain_file(path, _MOST_BYTES)
    if content is None:
        raise LoadError(f"cannot read table {name}: there is no such file")
    try:
        rows = list(csv.DictReader(io.StringIO(content.decode(), newline="")))
    except (UnicodeDecodeError, csv.Error) as error:
        raise LoadError(f"cannot read table {name}: {error}") from None
    groups: dict[tuple[str, str], list[dict[str, str]]] = {}
    try:
        for row in rows:
            groups.setdefault((row["problem"], row["run"]), []).append(row)
        other_efforts = {row["effort"] for row in rows} - {effort}
        results = [_result(group) for group in groups.values()]
    except (KeyError, ValueError, TypeError) as error:
        reason = f"it has no column {error}" if isinstance(error, KeyError) else error
        raise LoadError(
            f"{name} is not accuracy.csv of `pinred bench accuracy`: {reason}"
        ) from None
    if effort is not None and other_efforts:
        raise InputError(
            f"{name} was measured as '{min(other_efforts)}', not '{effort}': "
            "choose another folder, or the same options"
        )
    return results


def _result(rows: list[dict[str, str]]) -> WorkPrecision:
    head = rows[0]
    measured = [row for row in rows if row["tolerance"]]
    return WorkPrecision(
        problem=head["problem"],
        description=head["description"],
        joints=int(head["joints"]),
        duration=float(head["duration"]),
        reference_error=float(head["reference_error"]),
        reference=head["reference"],
        about={row["method"]: row["about"] for row in measured},
        points=tuple(_point(row) for row in measured),
        missing={row["method"]: row["failure"] for row in rows if not row["tolerance"]},
        run=head["run"],
    )


def _point(row: dict[str, str]) -> Point:
    numbers = {name: float(row[name]) for name in _POINT if name not in ("method", "failure")}
    if not math.isfinite(numbers["tolerance"]):
        raise ValueError(f"a tolerance of {row['tolerance']}")
    return Point(method=row["method"], failure=row["failure"], **numbers)
