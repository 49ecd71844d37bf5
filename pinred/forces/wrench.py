"""A wrench on the base, or on a point of any link."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

import numpy as np

from ..common.argument_kinds import checks_arguments
from ..common.arrays import as_floats
from ..common.errors import InputError
from ..common.names import brief, one_of
from ..common.parameter import Parameter, values_of
from ..system.force_interface import Load
from .force import (
    Action,
    Named,
    Symbols,
    Terms,
    acting_value,
    called,
    checked,
    entries,
    scalar,
    signals_in,
)
from .signals import Signal

Axes: TypeAlias = Literal["body", "world"]
AXES: tuple[Axes, ...] = ("body", "world")


@checks_arguments
@dataclass(frozen=True)
class Wrench(Named):
    """A wrench [linear; angular], such as thrust, drag, or a pull at a hand.

    Without a link it acts on the base: r entries along the group's axes, at the base's origin. On a
    link it has 3 entries, a force [N], or 6, a force and a moment [N; N·m].

    Attributes:
        function: (t, x, xdot, mu) → entries, called once with symbols; or a function of one
            SeenState with the same result; or a list of entries, each a Signal, a number, or such a
            function that returns one entry.
        name: Name in messages and results.
        link: Name of a link, or None for the base.
        at: Point of the link at which the wrench acts, in the link's frame, (3,) [m].
        frame: Axes along which the entries are measured. "body": the axes of the base or link;
            "world": those of the root joint's fixed frame, which is also the frame of pose and
            spatial momentum.
    """

    function: Action | Sequence[Action | Signal | float | Parameter]
    name: str = "wrench"
    link: str | None = field(default=None, kw_only=True)
    at: Sequence[float | Parameter] | None = field(default=None, kw_only=True)
    frame: Axes = field(default="body", kw_only=True)

    def __post_init__(self) -> None:
        expected = "a function of (t, x, xdot, mu), of a state, or a list of Signals or numbers"
        checked(self.name, expected, self.function, Sequence, np.ndarray)
        if not one_of(self.frame, AXES):
            raise InputError(
                f"frame of {self.name} must be one of {', '.join(AXES)}, got {brief(self.frame)}"
            )
        if self.link is not None and not isinstance(self.link, str):
            raise InputError(f"link of {self.name} must be a name, got {brief(self.link)}")
        if self.at is None:
            return
        if self.link is None:
            raise InputError(f"{self.name}: at= is a point of a link; pass link= as well")
        point = as_floats(values_of(self.at), f"at of {self.name}")
        if point.shape != (3,) or not np.isfinite(point).all():
            raise InputError(f"at of {self.name} must be 3 finite numbers, got {brief(self.at)}")
        coordinates = self.at.tolist() if isinstance(self.at, np.ndarray) else self.at
        object.__setattr__(self, "at", tuple(coordinates))

    @property
    def signals(self) -> Iterable[Signal]:
        """Signals in the wrench."""
        return () if callable(self.function) else signals_in(self.function)

    def terms(self, s: Symbols, number: Callable[[Any], Any]) -> Terms:
        """Return the wrench, or the load on a link.

        Args:
            s: Variables of the forces.
            number: Function that replaces a number by a symbol.
        Returns:
            The terms of this force.
        """
        values = self._entries(s, number, s.mu.numel())
        if self.link is None and self.frame == "body":
            return Terms(wrench=values)
        if self.link is None:
            return Terms(loads=[Load(None, [0.0] * 3, self.frame, values)])
        point = [number(a) if isinstance(a, Parameter) else float(a) for a in self.at or (0, 0, 0)]
        padded = [*values, *[0.0] * (6 - len(values))]
        return Terms(loads=[Load(self.link, point, self.frame, padded)])

    def _entries(self, s: Symbols, number: Callable[[Any], Any], r: int) -> list[Any]:
        """Return the entries as expressions; raise InputError if their number is wrong."""
        function = self.function
        value = called(function, s, self.name) if callable(function) else function
        if self.link is None:
            values = entries(value, r, self.name)
        else:
            values = entries(value, 3 if _count(value) == 3 else 6, f"{self.name} on a link")
        if callable(function):
            return [scalar(v, f"{self.name}[{i}]") for i, v in enumerate(values)]
        return [acting_value(v, s, number, f"{self.name}[{i}]") for i, v in enumerate(values)]


def _count(given: Any) -> int:
    """Return the number of entries of a value, 0 if it has none."""
    if hasattr(given, "numel"):
        return int(given.numel())
    return len(given) if hasattr(given, "__len__") else 0
