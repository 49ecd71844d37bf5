"""Base class of signals, and validation of their coefficients."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, as_floats, read_only, vector
from ...common.errors import InputError, ShapeError
from ...common.parameter import value_of, values_of

if TYPE_CHECKING:
    import casadi as ca

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
