"""Signals from formulas and tables, their base class, and validation of their coefficients."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, as_floats, positive, read_only, vector
from ...common.errors import InputError, ShapeError
from ...common.parameter import Affine, Numbers, Parameter, parameters_in, value_of, values_of
from .expressions import parse

if TYPE_CHECKING:
    import casadi as ca

ENDS = ("natural", "clamped", "not-a-knot", "periodic")
MOST_ENTRIES = 100_000  # largest number of table entries
_MOST_WEIGHTS = 30_000_000  # largest number of numbers of a table with Parameters
_MOST_HARMONICS = 1000
_ORDERS = ("value", "rate", "acceleration")


@checks_arguments
class Signal(ABC):
    """A scalar function of time [s], in the unit of the quantity it sets."""

    @abstractmethod
    def casadi(self, t: ca.SX, within: ca.SX | None = None) -> ca.SX:
        """Return the function at `t` as a scalar expression.

        `ca.jacobian` differentiates the expression exactly. An integrator that stops at the breaks
        passes as `within` a time between two breaks, so that the end of a step does not use the
        next segment. Outside the span, the first or last segment is extrapolated; a scene validates
        the span.

        Args:
            t: Time [s].
            within: Time that selects the segment of a table, even if t is outside of this segment.
                Signals without breaks ignore `within`.
        Returns:
            The expression.
        """

    def written(self, t: ca.SX, within: ca.SX | None, number: Callable[[Any], Any]) -> ca.SX:  # noqa: ARG002
        """Return the function at `t` like `casadi`, with the coefficients as kernel inputs.

        Signals that do not override this compile their coefficients into the kernel.

        Args:
            t: Time [s].
            within: Time that selects the segment of a table.
            number: Function that replaces a coefficient (number, Parameter or Affine) by a symbol.
        Returns:
            The expression.
        """
        return self.casadi(t, within)

    @abstractmethod
    def _numbers(self, t: Array, order: int) -> Array:
        """Return the derivative of the given order at times within the span."""

    @property
    def span(self) -> tuple[float, float]:
        """First and last time at which the function is defined [s]."""
        return -math.inf, math.inf

    @property
    def breaks(self) -> Array:
        """Times inside the span at which the function is not smooth, in increasing order [s]."""
        return read_only(np.empty(0))

    @property
    def smoothness(self) -> float:
        """Number of continuous derivatives at the breaks: 2 for a spline, −1 for jumps."""
        return math.inf

    def value(self, t: ArrayLike) -> Array:
        """Evaluate the function.

        Args:
            t: Times of any shape [s].
        Returns:
            Values, of the same shape.
        Raises:
            InputError: A time is outside of the span, or a result is not finite.
        """
        return self._checked(t, 0)

    def rate(self, t: ArrayLike) -> Array:
        """Evaluate the first derivative; at a break, its value in the segment after the break.

        Args:
            t: Times of any shape [s].
        Returns:
            Rates [1/s], of the same shape.
        Raises:
            InputError: A time is outside of the span, or a result is not finite.
        """
        return self._checked(t, 1)

    def acceleration(self, t: ArrayLike) -> Array:
        """Evaluate the second derivative; at a break, its value in the segment after the break.

        Args:
            t: Times of any shape [s].
        Returns:
            Accelerations [1/s²], of the same shape.
        Raises:
            InputError: A time is outside of the span, or a result is not finite.
        """
        return self._checked(t, 2)

    def _checked(self, t: ArrayLike, order: int) -> Array:
        times = as_floats(t, "t")
        first, last = self.span
        outside = ~(np.isfinite(times) & (times >= first) & (times <= last))
        if outside.any():
            raise InputError(
                f"t must be finite and from {first} s to {last} s, where this "
                f"{type(self).__name__} is defined, got {float(times[outside][0])} s"
            )
        with np.errstate(all="ignore"):
            numbers = np.asarray(self._numbers(times, order))
        wrong = ~np.isfinite(numbers)
        if wrong.any():
            raise InputError(
                f"the {_ORDERS[order]} of {self} is {float(numbers[wrong][0])} "
                f"at t = {float(times[wrong][0])} s"
            )
        return numbers


def number(value: Any, what: str) -> float:
    """Return a number, or the value of a Parameter, as a finite float."""
    array = as_floats(value_of(value), what)
    if array.ndim or not np.isfinite(array):
        raise InputError(f"{what} must be one finite number, got {value!r}")
    return float(array)


def finite_list(value: ArrayLike, what: str, most: int = _MOST_HARMONICS) -> Array:
    """Return a list of at most `most` finite numbers as a new array; Parameters give values."""
    array = as_floats(values_of(value), what)
    if array.ndim != 1:
        raise ShapeError(f"{what} must be a list of numbers, got shape {array.shape}")
    if array.size > most:
        raise InputError(
            f"{what} has {array.size} entries, more than {most}: keep only as many as the motion "
            "needs, or simulate in several segments"
        )
    return vector(array, array.size, what).copy()


@checks_arguments
@dataclass(frozen=True)
class Constant(Signal):
    """A constant: the same value at all times.

    Attributes:
        level: The value.
    """

    level: float | Parameter

    def __post_init__(self) -> None:
        object.__setattr__(self, "_given", self.level)
        object.__setattr__(self, "level", number(self.level, "the value of a Constant"))

    def casadi(self, t: ca.SX, within: ca.SX | None = None) -> ca.SX:
        """Return the value.

        Args:
            t: Time [s], unused.
            within: Unused.
        Returns:
            The expression.
        """
        return self.written(t, within, value_of)

    def written(self, t: ca.SX, within: ca.SX | None, number: Callable[[Any], Any]) -> ca.SX:  # noqa: ARG002
        """Return the value as an input of the kernel.

        Args:
            t: Time [s], unused.
            within: Unused.
            number: Function that replaces the value by a symbol.
        Returns:
            The expression.
        """
        import casadi as ca

        return ca.SX(number(vars(self)["_given"]))

    def _numbers(self, t: Array, order: int) -> Array:
        return np.full(t.shape, 0.0 if order else value_of(self.level))


@checks_arguments
@dataclass(frozen=True, eq=False)
class Fourier(Signal):
    """A Fourier series: mean + Σ aₖ cos(2πk t/period) + bₖ sin(2πk t/period), k from 1.

    Attributes:
        mean: Mean value.
        cosines: Coefficients aₖ of the cosines, (n,), at most 1000.
        sines: Coefficients bₖ of the sines, (n',), at most 1000.
        period: Period [s].
    """

    mean: float | Parameter
    cosines: Numbers
    sines: Numbers
    period: float | Parameter

    def __post_init__(self) -> None:
        arguments = {name: getattr(self, name) for name in ("mean", "cosines", "sines", "period")}
        object.__setattr__(self, "_given", arguments)
        object.__setattr__(self, "mean", number(self.mean, "mean of a Fourier"))
        period = positive(value_of(self.period), "period of a Fourier")
        object.__setattr__(self, "period", period)
        size = 0.0
        for name in ("cosines", "sines"):
            array = read_only(finite_list(getattr(self, name), f"{name} of a Fourier"))
            object.__setattr__(self, name, array)
            with np.errstate(over="ignore", invalid="ignore"):
                size += float(np.abs(array) @ self._frequencies(array.size) ** 2)
        if not math.isfinite(size):
            raise InputError(
                f"the acceleration of a Fourier with period {value_of(self.period):g} s overflows"
            )

    def casadi(self, t: ca.SX, within: ca.SX | None = None) -> ca.SX:
        """Return the series at `t`.

        Args:
            t: Time [s].
            within: Unused.
        Returns:
            The expression.
        """
        return self.written(t, within, value_of)

    def written(self, t: ca.SX, within: ca.SX | None, number: Callable[[Any], Any]) -> ca.SX:  # noqa: ARG002
        """Return the series at `t`, with its coefficients and frequency as inputs of the kernel.

        Args:
            t: Time [s].
            within: Unused.
            number: Function that replaces a coefficient by a symbol.
        Returns:
            The expression.
        """
        import casadi as ca

        arguments = vars(self)["_given"]
        if isinstance(arguments["period"], Parameter):
            angle = 2.0 * np.pi / number(arguments["period"]) * t
        else:
            angle = number(2.0 * np.pi / value_of(self.period)) * t
        result = ca.SX(number(arguments["mean"]))
        for name, wave in (("cosines", ca.cos), ("sines", ca.sin)):
            sizes: list[Any] = vars(self)[name].tolist()
            for k, parameter in parameters_in(arguments[name]):
                sizes[k] = parameter
            for k, size in enumerate(sizes, start=1):
                result += number(size) * wave(k * angle)
        return result

    @property
    def _coefficients(self) -> tuple[Array, Array]:
        return vars(self)["cosines"], vars(self)["sines"]

    def _frequencies(self, count: int) -> Array:
        """Return the angular frequencies 2πk/period of the first harmonics, (count,) [rad/s]."""
        with np.errstate(over="ignore"):
            return np.asarray(2 * np.pi * np.arange(1, count + 1) / value_of(self.period))

    def _numbers(self, t: Array, order: int) -> Array:
        result = np.full(t.shape, 0.0 if order else value_of(self.mean))
        for array, shift in zip(self._coefficients, (order, order - 1), strict=True):
            frequencies = self._frequencies(array.size)
            angles = t[..., None] * frequencies
            # The derivatives of cos are −sin, −cos, sin. Because cos is the derivative of sin, the
            # k-th derivative of sin is derivative k − 1 of cos.
            wave = (np.cos, np.sin)[shift % 2](angles) * (-1 if shift in (1, 2) else 1)
            result += wave @ (array * frequencies**order)
        return result


@checks_arguments
@dataclass(frozen=True)
class Expression(Signal):
    """A formula of the time `t`, such as "0.3*sin(2*t)"; see `expressions.parse` for its syntax.

    The signal itself reports no breaks. Integrators stop where conditions in a formula change, such
    as `where(t > 1, a, b)`. Jumps of other functions are unknown; use Hold or Linear for them.

    Attributes:
        text: The formula.
    """

    text: str

    def __post_init__(self) -> None:
        import casadi as ca

        self.casadi(ca.SX.sym("t"))

    @property
    def smoothness(self) -> float:
        """Infinity if every function in the formula is smooth where defined; −1 if unknown."""
        operations = {
            self._function.instruction_id(k) for k in range(self._function.n_instructions())
        }
        return -1 if operations & _nonsmooth_operations() else math.inf

    def casadi(self, t: ca.SX, within: ca.SX | None = None) -> ca.SX:  # noqa: ARG002
        """Return the formula at `t`.

        Args:
            t: Time [s].
            within: Unused.
        Returns:
            The expression.
        """
        return parse(self.text, {"t": t})

    def written(self, t: ca.SX, within: ca.SX | None, number: Callable[[Any], Any]) -> ca.SX:  # noqa: ARG002
        """Return the formula at `t`, with its numbers, except exponents, as inputs of the kernel.

        Args:
            t: Time [s].
            within: Unused.
            number: Function that replaces a number by a symbol.
        Returns:
            The expression.
        """
        return parse(self.text, {"t": t}, lambda value: number(Affine(value)))

    @cached_property
    def _function(self) -> ca.Function:
        """CasADi Function from t to value, rate and acceleration."""
        import casadi as ca

        t = ca.SX.sym("t")
        value = self.casadi(t)
        rate = ca.jacobian(value, t)
        values = ca.vertcat(value, rate, ca.jacobian(rate, t))
        return ca.Function("expression", [t], [ca.densify(values)])

    def _numbers(self, t: Array, order: int) -> Array:
        row: Array = np.array(self._function(t.reshape(1, -1)))[order]
        return row[: t.size].reshape(t.shape)  # CasADi returns one value for an empty input


def _nonsmooth_operations() -> set[int]:
    """Return the codes of CasADi's operations that have a jump or a kink."""
    import casadi as ca

    names = "FABS SIGN FLOOR CEIL FMIN FMAX LT LE EQ NE IF_ELSE_ZERO"
    return {getattr(ca, f"OP_{name}") for name in names.split()}


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
        return read_only(self.starts[1:])

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

        return PPoly(vars(self)["_coefficients"], np.append(self.starts, self.span[1]))


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
