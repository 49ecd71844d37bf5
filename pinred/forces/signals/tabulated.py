"""Signals from tables: splines, linear interpolation and steps."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, read_only, vector
from ...common.errors import InputError, ShapeError
from ...common.parameter import Affine, Numbers, Parameter, parameters_in, value_of, values_of
from .signal import Signal, finite_list

if TYPE_CHECKING:
    import casadi as ca

ENDS = ("natural", "clamped", "not-a-knot", "periodic")
MOST_ENTRIES = 100_000  # largest number of table entries
_MOST_WEIGHTS = 30_000_000  # largest number of numbers of a table with Parameters


@checks_arguments
@dataclass(frozen=True, eq=False)
class Table(Signal):
    """A polynomial on each interval between the entries of a table.

    Times and values become read-only copies.

    Attributes:
        times: Strictly increasing times, (n,) [s].
        values: Values, (n,); numbers or Parameters.
    """

    times: ArrayLike
    values: Numbers

    _least: ClassVar[int] = 2  # smallest number of table entries
    _smoothness: ClassVar[int]

    def __post_init__(self) -> None:
        name = type(self).__name__
        if next(parameters_in(self.times), None):
            raise InputError(
                f"times of a {name} define its breaks and cannot be Parameters; its values can"
            )
        times = finite_list(self.times, f"times of a {name}", MOST_ENTRIES)
        if times.size < self._least:
            raise ShapeError(f"a {name} needs at least {self._least} entries, got {times.size}")
        object.__setattr__(self, "_given", dict(parameters_in(self.values)))
        values = vector(values_of(self.values), times.size, f"values of a {name}").copy()
        with np.errstate(over="ignore"):
            late = np.flatnonzero(np.diff(times) <= 0)
        if late.size:
            k = int(late[0]) + 1
            raise InputError(
                f"times of a {name} must increase strictly, but entry {k} ({float(times[k])} s) "
                f"follows {float(times[k - 1])} s"
            )
        object.__setattr__(self, "times", read_only(times))
        object.__setattr__(self, "values", read_only(values))
        with np.errstate(all="ignore"):
            coefficients = self._pieces(times, values)
        wrong = ~np.isfinite(coefficients).all(axis=0)
        if wrong.any():
            k = int(np.argmax(wrong))
            raise InputError(
                f"a {name} through these values overflows after entry {k} ({float(times[k])} s): "
                "times too close or values too large"
            )
        object.__setattr__(self, "_starts", times[: coefficients.shape[1]])
        object.__setattr__(self, "_coefficients", read_only(coefficients))

    @abstractmethod
    def _pieces(self, times: Array, values: Array) -> Array:
        """Return the coefficients of the p segments, (degree + 1, p), highest power first.

        Segment k is a polynomial in the time since table entry k.
        """

    @property
    def span(self) -> tuple[float, float]:
        """First and last time of the table [s]."""
        times: Array = vars(self)["times"]
        return float(times[0]), float(times[-1])

    @property
    def breaks(self) -> Array:
        """Times at which one segment ends and the next begins [s]."""
        starts: Array = vars(self)["_starts"]
        return read_only(starts[1:])

    @property
    def smoothness(self) -> float:
        """Number of continuous derivatives at the entries of the table."""
        return self._smoothness

    @property
    def starts(self) -> Array:
        """Start of each segment, (p,) [s]."""
        starts: Array = vars(self)["_starts"]
        return starts

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The distinct Parameters among the values."""
        parameters: dict[int, Parameter] = vars(self)["_given"]
        return tuple(dict.fromkeys(parameters.values()))

    @property
    def width(self) -> int:
        """Number of numbers that define a segment."""
        coefficients: Array = vars(self)["_coefficients"]
        return 1 + len(coefficients) * (1 + len(self.parameters))

    def segments(self) -> Array:
        """Return the start, the coefficients and their weights of all segments, (p, width).

        The weights of each Parameter follow the coefficients, which are those for Parameters of
        value zero.

        Raises:
            InputError: The weights need too much memory.
        """
        times, values = vars(self)["times"], vars(self)["values"]
        coefficients: Array = vars(self)["_coefficients"]
        if not self.parameters:
            return np.vstack([self.starts, coefficients]).T
        if len(self.starts) * self.width > _MOST_WEIGHTS:
            raise InputError(
                f"a {type(self).__name__} with {times.size} entries can have at most "
                f"{max(_MOST_WEIGHTS // coefficients.size - 2, 1)} Parameters among its values, "
                f"got {len(self.parameters)}. Use a shorter table"
            )
        parameters: dict[int, Parameter] = vars(self)["_given"]
        base = values.copy()
        base[list(parameters)] = 0.0
        # The coefficients are linear in the values, and one Parameter may occur in several values.
        units = {parameter: np.zeros(times.size) for parameter in self.parameters}
        for k, parameter in parameters.items():
            units[parameter][k] = 1.0
        pieces = [self._pieces(times, column) for column in (base, *units.values())]
        return np.vstack([self.starts, *pieces]).T

    def casadi(self, t: ca.SX, within: ca.SX | None = None) -> ca.SX:
        """Evaluate at `t` the polynomial of the segment that contains `within`.

        If `within` is None, the segment that contains `t` is used.  The expression contains all
        segments.

        Args:
            t: Time [s].
            within: Time that selects the segment, or None.
        Returns:
            The expression.
        """
        return self._in_all_segments(t, within, value_of)

    def written(self, t: ca.SX, within: ca.SX | None, number: Callable[[Any], Any]) -> ca.SX:
        """Evaluate at `t` the polynomial of the segment that contains `within`.

        The segment is an input of the kernel, so that the expression does not depend on the number
        of segments.  It contains all segments if the force does not name the table among its
        signals.

        Args:
            t: Time [s].
            within: Time that selects the segment, or None.
            number: Function that replaces a coefficient by a symbol, and a table by the symbols of
                its segment.
        Returns:
            The expression.
        """
        import casadi as ca

        segment: list[ca.SX] | Table = number(self)
        if isinstance(segment, Table):
            return self._in_all_segments(t, within, number)
        parameters = [number(parameter) for parameter in self.parameters]
        degrees = len(vars(self)["_coefficients"])
        since: ca.SX = t - segment[0]
        result: ca.SX = ca.SX(0)
        for k in range(1, degrees + 1):
            result = result * since + _combined(segment[k::degrees], parameters)
        return result

    def _in_all_segments(
        self, t: ca.SX, within: ca.SX | None, number: Callable[[Any], Any]
    ) -> ca.SX:
        """Return the polynomial of the segment that contains `within`, or t if it is None.

        The coefficients are multiplied by 1 for this segment and by 0 for the others, and added.
        The sum and all its derivatives are exact, because these factors are constant.
        """
        import casadi as ca

        parameters = [number(parameter) for parameter in self.parameters]
        table = self.segments()
        # Kernels are tested with random numbers close to these values, so that the times stay in
        # order.
        start_symbols = [number(Affine(start)) for start in self.starts.tolist()]
        now = t if within is None else within
        has_started = ca.vertcat(ca.SX(0, 1), *(begin <= now for begin in start_symbols[1:]))
        is_selected = ca.vertcat(1, has_started) - ca.vertcat(has_started, 0)
        since = t - ca.dot(ca.SX(ca.vertcat(*start_symbols)), is_selected)
        result, degrees = ca.SX(0), len(vars(self)["_coefficients"])
        for k in range(1, degrees + 1):
            rows = table[:, k::degrees].tolist()
            values = [_combined([number(row[0]), *row[1:]], parameters) for row in rows]
            result = result * since + ca.dot(ca.SX(ca.vertcat(*values)), is_selected)
        return result

    def _numbers(self, t: Array, order: int) -> Array:
        numbers: Array = self._curve(t, order)
        return numbers

    @cached_property
    def _curve(self) -> Any:
        """The piecewise polynomial as a SciPy PPoly object."""
        from scipy.interpolate import PPoly

        starts, coefficients = vars(self)["_starts"], vars(self)["_coefficients"]
        return PPoly(coefficients, np.append(starts, self.span[1]))


def _combined(terms: Sequence[Any], parameters: Sequence[Any]) -> Any:
    """Return the first of the terms plus the parameters, weighted with the other terms."""
    value = terms[0]
    for weight, parameter in zip(terms[1:], parameters, strict=True):
        value = value + weight * parameter
    return value


@checks_arguments
@dataclass(frozen=True, eq=False)
class Spline(Table):
    """The cubic spline through a table, continuous up to its acceleration.

    Attributes:
        times: Strictly increasing times, (n,), 2 to 100,000 of them [s].
        values: Values, (n,).
        end: Condition at both ends. "natural": zero acceleration; "clamped": zero rate;
            "not-a-knot": the first two segments are one cubic, and so are the last two; "periodic":
            value, rate and acceleration are equal at both ends (the table is one period and is not
            repeated).
    """

    end: Literal["natural", "clamped", "not-a-knot", "periodic"] = field(
        default="natural", kw_only=True
    )

    _smoothness: ClassVar[int] = 2

    def _pieces(self, times: Array, values: Array) -> Array:
        from scipy.interpolate import CubicSpline

        if self.end not in ENDS:
            raise InputError(f"end of a Spline must be one of {', '.join(ENDS)}, got {self.end!r}")
        if self.end == "periodic" and values[0] != values[-1]:
            raise InputError(
                "a periodic Spline ends with the value it begins with, "
                f"got {float(values[0])} and {float(values[-1])}"
            )
        try:
            curve = CubicSpline(times, values, bc_type=self.end)
        except (ValueError, np.linalg.LinAlgError):
            raise InputError(
                "no spline can be put through these values: times too close or values too large"
            ) from None
        return np.array(curve.c)


@checks_arguments
@dataclass(frozen=True, eq=False)
class Linear(Table):
    """Linear interpolation of a table. Its rate jumps, so it cannot prescribe a joint's motion.

    Attributes:
        times: Strictly increasing times, (n,), 2 to 100,000 of them [s].
        values: Values, (n,).
    """

    _smoothness: ClassVar[int] = 0

    def _pieces(self, times: Array, values: Array) -> Array:
        return np.vstack([np.diff(values) / np.diff(times), values[:-1]])


@checks_arguments
@dataclass(frozen=True, eq=False)
class Hold(Table):
    """Steps (zero-order hold): each value applies from its time to the next, the last one forever.

    Attributes:
        times: Strictly increasing times, (n,), 1 to 100,000 of them [s].
        values: Values, (n,).
    """

    _least: ClassVar[int] = 1
    _smoothness: ClassVar[int] = -1

    @property
    def span(self) -> tuple[float, float]:
        """First time of the table, and infinity [s]."""
        return super().span[0], math.inf

    def _pieces(self, times: Array, values: Array) -> Array:  # noqa: ARG002
        return values[None]

    def _numbers(self, t: Array, order: int) -> Array:
        times, values = vars(self)["times"], vars(self)["values"]
        numbers: Array = values[np.searchsorted(times, t, side="right") - 1]
        return np.zeros(t.shape) if order else numbers
