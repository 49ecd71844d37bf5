"""Signals and attitudes in files: numbers, formulas, tables of points, and columns of csv files."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...common.arrays import Array
from ...common.errors import InputError, PinredError
from ...common.names import quoted_path
from ...forces.signals import Attitude, Constant, Expression, Fourier, Hold, Linear, Signal, Spline
from ...forces.signals.attitude_signal import parse_attitude
from ...forces.signals.signal import ENDS
from .file_place import Place, naming, read_text, shown, unknown
from .schema import ByName, Either, Key, ListOf, Number, Table, Text, Whole


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
    value = _float(row[k]) if k < len(row) else None
    if value is not None and math.isfinite(value):
        return value
    where = f"{quoted_path(path)}, line {line}, column {k}"  # slow for each of 100,000 rows
    if k >= len(row):
        raise InputError(f"{where}: there are only {len(row)} columns")
    raise InputError(f"{where}: must be a finite number, got {shown(row[k])}")


def _float(cell: str) -> float | None:
    try:
        return None if "_" in cell else float(cell)
    except ValueError:
        return None


NUMBER, POSITIVE = Number(), Number(positive=True)
NUMBERS = ListOf(NUMBER)
PER_JOINT = Either((NUMBER, ByName(NUMBER)), "per_joint")
SHAPE = Either((NUMBERS, ByName(Either((NUMBER, NUMBERS)))), "shape")
_TABULATED: dict[str, Callable[..., Signal]] = {"spline": Spline, "linear": Linear, "hold": Hold}


def _tabulated(words: str, **more: Key) -> Table:
    """Return the table (keys) of a signal through points from the scene file or a csv file."""
    columns = ListOf(Either((Text((), "a name"), Whole())), 2)
    keys = {
        "times": Key(NUMBERS, "strictly increasing times [s], at most 100,000"),
        "values": Key(NUMBERS, "signal values, one for each time"),
        "file": Key(Text(), "csv file with the times and values, relative to this file"),
        "columns": Key(
            columns,
            "csv columns of time and value, as two names in the header or two indices from 0",
            default="[0, 1]",
        ),
        **more,
    }
    return Table(
        keys,
        words,
        needs={"times": "values", "values": "times", "columns": "file"},
        one_of=("times", "file"),
    )


_END = Key(Text(ENDS), "condition at both ends of the spline", default=ENDS[0])
_FOURIER = Table(
    {
        "mean": Key(NUMBER, "mean value", default="0"),
        "cosines": Key(NUMBERS, "amplitudes of cos(2πk t/period), k from 1", default="none"),
        "sines": Key(NUMBERS, "amplitudes of sin(2πk t/period), k from 1", default="none"),
        "period": Key(POSITIVE, "period [s]", required=True),
    },
    "a Fourier series",
)
_KINDS = {
    "spline": Key(_tabulated("a cubic spline", end=_END), "cubic spline through points"),
    "linear": Key(_tabulated("straight lines"), "linear interpolation between points"),
    "hold": Key(_tabulated("steps"), "zero-order hold: each value is kept until the next time"),
    "fourier": Key(_FOURIER, "mean + Σ aₖ cos(2πk t/period) + bₖ sin(2πk t/period)"),
}
SIGNAL_TABLE = Table(_KINDS, "a signal table", one_of=tuple(_KINDS), name="signal_table")
_TIME = Text((), "a formula in t")
SIGNAL = Either((NUMBER, _TIME, SIGNAL_TABLE), "signal")
_ATTITUDE = Table(
    {
        "vector": Key(ListOf(SIGNAL, 3), "rotation vector w(t) in the axes of the child [rad]"),
        "centre": Key(
            NUMBERS,
            "constant attitude R_c of R_c exp(w(t)): rotation vector [rad] or quaternion "
            "(x, y, z, w)",
            default="no rotation",
        ),
        "times": Key(NUMBERS, "strictly increasing times [s], at most 100,000"),
        "attitudes": Key(
            ListOf(NUMBERS),
            "rotation vectors [rad] or quaternions, one for each time, of which the unwrapped "
            "rotation vectors about the centre are interpolated",
        ),
        "end": Key(Text(ENDS), "condition at both ends of the splines", default=ENDS[0]),
    },
    "an attitude",
    needs={"times": "attitudes", "attitudes": "times", "end": "times"},
    one_of=("vector", "times"),
)
_OF_BALL = Key(_ATTITUDE, "attitude of a ball joint, R(t) = R_c exp(w(t))")
ATTITUDE = Either(
    (
        ListOf(SIGNAL),
        Table({"attitude": _OF_BALL}, "a table with the key attitude", one_of=("attitude",)),
    ),
    "attitude",
)
_PLANS = {**_KINDS, "attitude": _OF_BALL}
PLAN_TABLE = Table(_PLANS, "a signal table", one_of=tuple(_PLANS), name="plan_table")
PLAN = Either((NUMBER, _TIME, ListOf(SIGNAL), PLAN_TABLE), "plan")
_FORMULA = Text((), "a formula in t, x, xdot and mu")
ACTION = Either((NUMBER, _FORMULA, SIGNAL_TABLE), "action")


class SignalReader:
    """A reader of the signals in one file, which stores the place of each signal for messages.

    Args:
        folder: Folder to which the names of csv files are relative.
    """

    def __init__(self, folder: Path) -> None:
        """Create a reader that has not read any signals yet."""
        self._folder = folder
        self._places: list[tuple[Signal, Place]] = []

    def motion(self, value: Any, place: Place) -> Signal | Attitude:
        """Convert a validated value to a Signal; a number becomes a constant signal.

        Args:
            value: Number, formula in t, or signal table; for a ball a list of signals, or a table
                with the key attitude.
            place: Its place in the file.
        Returns:
            The signal, or the attitude of a ball.
        Raises:
            InputError: the value does not define a valid signal; the message names the place.
            LoadError: a csv file cannot be read.
        """
        plan = self.plan(value, place)
        return self._remember(Constant(plan), place) if isinstance(plan, float) else plan

    def plan(self, value: Any, place: Place) -> Signal | Attitude | float:
        """Convert a validated value to a Signal or an Attitude; return a number unchanged."""
        if isinstance(value, list) or (isinstance(value, dict) and "attitude" in value):
            return self.attitude(value, place)
        return self.value(value, place)

    def attitude(self, value: Any, place: Place) -> Attitude:
        """Convert a validated list of signals, or a table with the key attitude (see motion)."""
        if isinstance(value, list):
            with naming(place):
                return parse_attitude([self.value(v, place / k) for k, v in enumerate(value)])
        place, table = place / "attitude", value["attitude"]
        centre = table.get("centre", (0.0, 0.0, 0.0))
        with naming(place):
            if "vector" in table:
                at = place / "vector"
                vector = [self.value(v, at / k) for k, v in enumerate(table["vector"])]
                return Attitude(vector, centre)
            end = table.get("end", ENDS[0])
            return Attitude.through(table["times"], table["attitudes"], centre, end=end)

    def value(self, value: Any, place: Place) -> Signal | float:
        """Convert a validated value to a Signal, but return a number unchanged (see motion)."""
        if isinstance(value, float):
            return value
        if isinstance(value, str):
            with naming(place):
                return self._remember(Expression(value), place)
        ((kind, table),) = value.items()
        place = place / kind
        options = dict(table)
        if "file" in options:
            columns = options.pop("columns", [0, 1])
            with naming(place / "file"):
                points = read_columns(self._folder / options.pop("file"), columns)
            options |= {"times": points[:, 0], "values": points[:, 1]}
        with naming(place):
            if kind == "fourier":
                options = {"mean": 0.0, "cosines": [], "sines": [], **options}
                return self._remember(Fourier(**options), place)
            return self._remember(_TABULATED[kind](**options), place)

    def of_error(self, error: PinredError) -> tuple[Place, str] | None:
        """Return the place of the signal that an error names, and the message without it."""
        text = str(error)
        for signal, place in self._places:
            if repr(signal) in text:
                return place, text.replace(repr(signal), f"this {type(signal).__name__}")
        return None

    def _remember(self, signal: Signal, place: Place) -> Signal:
        self._places.append((signal, place))
        return signal
