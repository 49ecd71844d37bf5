"""Signals from scene files: numbers, formulas in t, tables and Fourier series."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from ...common.errors import PinredError
from ...forces.signals import Constant, Expression, Fourier, Hold, Linear, Signal, Spline
from .csv_columns import read_columns
from .places import Place, naming

_TABLES: dict[str, Callable[..., Signal]] = {"spline": Spline, "linear": Linear, "hold": Hold}


class SignalReader:
    """A reader of the signals in one file, which remembers where each stands.

    folder: the one to which names of csv files are relative.
    """

    def __init__(self, folder: Path) -> None:
        """Take the folder."""
        self._folder = folder
        self._read: list[tuple[Signal, Place]] = []

    def motion(self, value: Any, place: Place) -> Signal:
        """Return a value as a Signal.  Raises InputError or LoadError that names the place."""
        signal = self.value(value, place)
        return signal if isinstance(signal, Signal) else self._kept(Constant(signal), place)

    def value(self, value: Any, place: Place) -> Signal | float:
        """Return a number as it is, and all else as a Signal; errors as of `motion`."""
        if isinstance(value, float):
            return value
        if isinstance(value, str):
            with naming(place):
                return self._kept(Expression(value), place)
        ((kind, table),) = value.items()
        place = place / kind
        options = dict(table)
        if "file" in options:
            columns = options.pop("columns", [0, 1])
            with naming(place / "file"):
                both = read_columns(self._folder / options.pop("file"), columns)
            options |= {"times": both[:, 0], "values": both[:, 1]}
        with naming(place):
            if kind == "fourier":
                options = {"mean": 0.0, "cosines": [], "sines": [], **options}
                return self._kept(Fourier(**options), place)
            return self._kept(_TABLES[kind](**options), place)

    def of_error(self, error: PinredError) -> tuple[Place, str] | None:
        """Return the place of the signal that an error is about, and the text without it."""
        text = str(error)
        for signal, place in self._read:
            if repr(signal) in text:
                return place, text.replace(repr(signal), f"this {type(signal).__name__}")
        return None

    def _kept(self, signal: Signal, place: Place) -> Signal:
        self._read.append((signal, place))
        return signal
