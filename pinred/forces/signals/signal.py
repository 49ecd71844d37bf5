"""The base of all signals."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ...common.arrays import Array, as_floats, read_only, vector
from ...common.errors import InputError, ShapeError
from ...common.parameter import value_of, values_of

if TYPE_CHECKING:
    import casadi as ca

MOST = 1000  # entries of a table, harmonics of a series
_ORDERS = ("value", "rate", "acceleration")


class Signal(ABC):
    """A scalar function of time [s], in the unit of what it drives."""

    @abstractmethod
    def casadi(self, t: ca.SX, within: ca.SX | None = None) -> ca.SX:
        """Return the function at `t`, scalar; `ca.jacobian` differentiates it exactly.

        within: a time whose piece of the table is taken, even where t lies beyond that piece.
        An integrator that stops at the breaks gives a time between them, so that the end of a
        step does not see the next piece.  Signals without breaks do not use it.

        Outside the span, the first or last piece goes on; a scene checks the span when it is
        built.
        """

    def written(self, t: ca.SX, within: ca.SX | None, number: Callable[[Any], Any]) -> ca.SX:  # noqa: ARG002
        """Return the function at `t` as `casadi` does, with its coefficients as inputs.

        number: turns a coefficient (a number, a Parameter, or what is Affine in some) into a
        symbol.  A Signal that does not define it has its coefficients in the kernel.
        """
        return self.casadi(t, within)

    @abstractmethod
    def _numbers(self, t: Array, order: int) -> Array:
        """Return the derivative of an order at times within the span."""

    @property
    def span(self) -> tuple[float, float]:
        """The first and the last time at which the function is known [s]."""
        return -math.inf, math.inf

    @property
    def breaks(self) -> Array:
        """The times inside the span where the function is not smooth, increasing [s]."""
        return read_only(np.empty(0))

    @property
    def smoothness(self) -> float:
        """The number of derivatives continuous at the breaks: 2 of a spline, −1 at jumps."""
        return math.inf

    def value(self, t: ArrayLike) -> Array:
        """Return the function at times of any shape.

        Raises InputError if a time is outside of the span or the result is not finite.
        """
        return self._checked(t, 0)

    def rate(self, t: ArrayLike) -> Array:
        """Return the first derivative [1/s]; at a break, that of the piece after it."""
        return self._checked(t, 1)

    def acceleration(self, t: ArrayLike) -> Array:
        """Return the second derivative [1/s²]; at a break, that of the piece after it."""
        return self._checked(t, 2)

    def _checked(self, t: ArrayLike, order: int) -> Array:
        times = as_floats(t, "t")
        first, last = self.span
        outside = ~(np.isfinite(times) & (times >= first) & (times <= last))
        if outside.any():
            raise InputError(
                f"t must be finite and from {first} s to {last} s, where this "
                f"{type(self).__name__} is known, got {float(times[outside][0])} s"
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
    """Return `value` as a finite float; of a Parameter, its value."""
    array = as_floats(value_of(value), what)
    if array.ndim or not np.isfinite(array):
        raise InputError(f"{what} must be one finite number, got {value!r}")
    return float(array)


def finite_list(value: ArrayLike, what: str) -> Array:
    """Return a copy of `value`, finite and of at most MOST entries; of Parameters, the values."""
    array = as_floats(values_of(value), what)
    if array.ndim != 1:
        raise ShapeError(f"{what} must be a list of numbers, got shape {array.shape}")
    if array.size > MOST:
        raise InputError(
            f"{what} has {array.size} entries, more than the {MOST} that a scene can have "
            "compiled: keep only as many as the motion needs, or simulate one part after another"
        )
    return vector(array, array.size, what).copy()
