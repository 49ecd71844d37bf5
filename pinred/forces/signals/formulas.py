"""Signals from formulas: a constant, a Fourier series, an expression."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, positive, read_only
from ...common.errors import InputError
from ...common.parameter import Affine, Numbers, Parameter, parameters_in, value_of
from .expressions import parse
from .signal import Signal, finite_list, number

if TYPE_CHECKING:
    import casadi as ca


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
