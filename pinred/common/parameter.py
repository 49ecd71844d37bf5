"""Parameters: numbers with names, which vary without another kernel and have derivatives."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import isfinite
from typing import TYPE_CHECKING, Any, TypeAlias
from weakref import WeakValueDictionary

from numpy.typing import ArrayLike

from .errors import InputError
from .plain_names import brief

if TYPE_CHECKING:
    import casadi as ca

_known: WeakValueDictionary[int, Parameter] = WeakValueDictionary()  # by the hash of the symbol


@dataclass(frozen=True, eq=False)
class Parameter:
    """A number with a name, in forces and signals: an input of the kernel, not a part of it.

    It stands wherever a number does, and in the expressions of a force, where it is a CasADi
    symbol: `-gain * x["hinge"]`, `casadi.sin(gain)`.  value: its number where a scene or flow says
    nothing else (`parameters={"gain": 2.1}`).  Two of one name in a scene are one if they are the
    same object, and an error if not.
    """

    name: str
    value: float

    __array_ufunc__ = None  # NumPy leaves arithmetic to it

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
        """The symbol that stands for it in expressions; its name is that of all parameters."""
        import casadi as ca

        # A name of its own would make another kernel of the same expressions.
        symbol = ca.SX.sym("parameter")
        _known[symbol.element_hash()] = self
        return symbol

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.name, self.value)

    def __SX__(self) -> ca.SX:
        return self.symbol

    def __add__(self, other: Any) -> Any:
        return self.symbol + other

    def __radd__(self, other: Any) -> Any:
        return other + self.symbol

    def __sub__(self, other: Any) -> Any:
        return self.symbol - other

    def __rsub__(self, other: Any) -> Any:
        return other - self.symbol

    def __mul__(self, other: Any) -> Any:
        return self.symbol * other

    def __rmul__(self, other: Any) -> Any:
        return other * self.symbol

    def __truediv__(self, other: Any) -> Any:
        return self.symbol / other

    def __rtruediv__(self, other: Any) -> Any:
        return other / self.symbol

    def __pow__(self, other: Any) -> Any:
        return self.symbol**other

    def __rpow__(self, other: Any) -> Any:
        return other**self.symbol

    def __neg__(self) -> Any:
        return -self.symbol

    def __pos__(self) -> Any:
        return self.symbol


@dataclass(frozen=True)
class Affine:
    """A number that follows from parameters: base + Σ weight · parameter.

    It may have none: then it is a number of a formula, which need not make sense with others.
    """

    base: float
    weights: Mapping[Parameter, float] = field(default_factory=dict)

    @property
    def value(self) -> float:
        """The number at the parameters' own values."""
        return self.base + sum(weight * each.value for each, weight in self.weights.items())


Numbers: TypeAlias = ArrayLike | Sequence[Any]


def value_of(number: Any) -> Any:
    """Return the value of a number that may be a Parameter; anything else is returned as it is."""
    return number.value if isinstance(number, (Parameter, Affine)) else number


def values_of(numbers: Any) -> Any:
    """Return a list with the values of the Parameters in it; anything else as it is."""
    if isinstance(numbers, (list, tuple)) and any(isinstance(n, Parameter) for n in numbers):
        return [value_of(number) for number in numbers]
    return numbers


def parameters_in(numbers: Any) -> Iterator[tuple[int, Parameter]]:
    """Yield the Parameters in a list of numbers, with their places."""
    if isinstance(numbers, (list, tuple)):
        for k, number in enumerate(numbers):
            if isinstance(number, Parameter):
                yield k, number


def parameter_of(symbol: ca.SX) -> Parameter | None:
    """Return the Parameter that a symbol stands for, if it does for one."""
    return _known.get(symbol.element_hash())


def checked_number(value: Any, check: Callable[[Any], float]) -> float | Parameter:
    """Return a Parameter whose value passes a check, or the number that the check gives."""
    if isinstance(value, Parameter):
        check(value.value)
        return value
    return check(value)
