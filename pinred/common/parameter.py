"""Parameters: named numbers that can vary without recompilation and have derivatives."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import isfinite
from typing import TYPE_CHECKING, Any, TypeAlias
from weakref import WeakValueDictionary

from numpy.typing import ArrayLike

from .argument_kinds import checks_arguments
from .errors import InputError
from .names import brief

if TYPE_CHECKING:
    import casadi as ca

_by_symbol: WeakValueDictionary[int, Parameter] = (
    WeakValueDictionary()
)  # Parameters by the hash of their symbol


_Operator: TypeAlias = Callable[[Any, Any], Any]


def _both_sides(operation: _Operator) -> tuple[_Operator, _Operator]:
    """Return an operator's methods for a Parameter on the left side and on the right side."""
    return (
        lambda parameter, other: operation(parameter.symbol, other),
        lambda parameter, other: operation(other, parameter.symbol),
    )


@checks_arguments
@dataclass(frozen=True, eq=False)
class Parameter:
    """A named number in forces and signals that is an input of the compiled kernel.

    A Parameter replaces a number in any force or signal.  In expressions it acts as a CasADi
    symbol: `-gain * x["hinge"]`, `casadi.sin(gain)`.  Its value can change without a new
    compilation, and flows compute derivatives with respect to it.  If a scene
    uses the same name twice, both must be the same Parameter object.

    Attributes:
        name: Name of the parameter.
        value: Value, unless a scene or flow sets another (`parameters={"gain": 2.1}`).
    """

    name: str
    value: float

    __array_ufunc__ = None  # makes NumPy call the operators of this class

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name.strip():
            raise InputError(f"the name of a Parameter must be text, got {brief(self.name)}")
        try:
            value = float(self.value)
        except (TypeError, ValueError, OverflowError):
            value = float("nan")
        if isinstance(self.value, bool) or not isfinite(value):
            raise InputError(
                f"the value of Parameter '{self.name}' must be a finite number, "
                f"got {brief(self.value)}"
            )
        object.__setattr__(self, "value", value)

    @cached_property
    def symbol(self) -> ca.SX:
        """The CasADi symbol of this parameter in expressions."""
        import casadi as ca

        # All symbols share one name, so that equal expressions share one kernel.
        symbol = ca.SX.sym("parameter")
        _by_symbol[symbol.element_hash()] = self
        return symbol

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.name, self.value)

    def __SX__(self) -> ca.SX:
        return self.symbol

    __add__, __radd__ = _both_sides(operator.add)
    __sub__, __rsub__ = _both_sides(operator.sub)
    __mul__, __rmul__ = _both_sides(operator.mul)
    __truediv__, __rtruediv__ = _both_sides(operator.truediv)
    __pow__, __rpow__ = _both_sides(operator.pow)

    def __neg__(self) -> Any:
        return -self.symbol

    def __pos__(self) -> Any:
        return self.symbol


@dataclass(frozen=True)
class Affine:
    """A number that depends linearly on parameters: base + Σ weight · parameter.

    An Affine without weights is a constant in a formula that other values may invalidate.

    Attributes:
        base: Constant term.
        weights: Weight of each parameter.
    """

    base: float
    weights: Mapping[Parameter, float] = field(default_factory=dict)

    @property
    def value(self) -> float:
        """The number at the default values of the parameters."""
        return self.base + sum(
            weight * parameter.value for parameter, weight in self.weights.items()
        )


Numbers: TypeAlias = ArrayLike | Sequence[Any]


def value_of(number: Any) -> Any:
    """Return the value of a Parameter or Affine; return any other object unchanged."""
    return number.value if isinstance(number, (Parameter, Affine)) else number


def values_of(numbers: Any) -> Any:
    """Replace the Parameters in a list by their values; return any other object unchanged."""
    if isinstance(numbers, (list, tuple)) and any(isinstance(n, Parameter) for n in numbers):
        return [value_of(number) for number in numbers]
    return numbers


def parameters_in(numbers: Any) -> Iterator[tuple[int, Parameter]]:
    """Yield the Parameters in a list of numbers, with their indices."""
    if isinstance(numbers, (list, tuple)):
        for k, number in enumerate(numbers):
            if isinstance(number, Parameter):
                yield k, number


def parameter_of(symbol: ca.SX) -> Parameter | None:
    """Return the Parameter of a CasADi symbol, or None."""
    return _by_symbol.get(symbol.element_hash())


def checked_number(value: Any, check: Callable[[Any], float]) -> float | Parameter:
    """Check a number or the value of a Parameter.

    Args:
        value: A number or a Parameter.
        check: Function that validates and converts a number.
    Returns:
        The Parameter itself, or the converted number.
    """
    if isinstance(value, Parameter):
        check(value.value)
        return value
    return check(value)
