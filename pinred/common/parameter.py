"""Parameters: named numbers that can vary without recompilation and have derivatives."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import isfinite
from typing import TYPE_CHECKING, Any, TypeAlias
from weakref import WeakValueDictionary

from numpy.typing import ArrayLike

from .argument_kinds import checks_arguments
from .arrays import Array, as_floats, dimensions, is_finite, read_only
from .errors import InputError, ShapeError
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


class _Operators:
    """Arithmetic of an object that has a CasADi symbol."""

    symbol: Any

    __array_ufunc__ = None  # makes NumPy call the operators of this class

    def __SX__(self) -> Any:
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


@checks_arguments
@dataclass(frozen=True, eq=False, init=False)
class Parameter(_Operators):
    """A named number in forces and signals that is an input of the compiled kernel.

    A Parameter replaces a number in any force or signal.  In expressions it acts as a CasADi
    symbol: `-gain * x["hinge"]`, `casadi.sin(gain)`.  Its value can change without a new
    compilation, and flows compute derivatives with respect to it.  If a scene
    uses the same name twice, both must be the same Parameter object.

    `Parameter("u", np.zeros(12))` is a vector of parameters under one name.  Its entries `u[0]`,
    `u[1]`, … are Parameters that replace numbers.  Scenes and flows have one input `u`, (12,).

    Attributes:
        name: Name of the parameter.
        value: Value, unless a scene or flow sets another (`parameters={"gain": 2.1}`).
    """

    name: str
    value: float

    def __new__(cls, name: Any = "", value: Any = None) -> Any:  # noqa: D102
        return VectorParameter(name, value) if dimensions(value) else super().__new__(cls)

    def __init__(self, name: str, value: float | Sequence[float] | Array) -> None:
        """Validate the name and the value.

        Args:
            name: Name of the parameter.
            value: A number, or a vector (k,).
        Raises:
            InputError: The name is not text, or the value is not finite.
            ShapeError: The value is an array that is empty or has several axes.
        """
        _check_name(name)
        try:
            number = float(value)  # type: ignore[arg-type]
        except (TypeError, ValueError, OverflowError):
            number = float("nan")
        if isinstance(value, bool) or not isfinite(number):
            raise InputError(
                f"the value of Parameter '{name}' must be a finite number, got {brief(value)}"
            )
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "value", number)

    @cached_property
    def symbol(self) -> ca.SX:
        """The CasADi symbol of this parameter in expressions."""
        import casadi as ca

        # All symbols share one name, so that equal expressions share one kernel.
        symbol = ca.SX.sym("parameter")
        _by_symbol[symbol.element_hash()] = self
        return symbol

    @property
    def place(self) -> tuple[VectorParameter, int] | None:
        """The vector parameter that has this entry, and its index; None for other parameters."""
        return vars(self).get("_place")

    def __reduce__(self) -> tuple[Any, ...]:
        if self.place is not None:  # Copies of the entries of one vector have one vector again.
            return operator.getitem, self.place
        return type(self), (self.name, self.value)

    if TYPE_CHECKING:  # A Parameter of an array is a VectorParameter, which has these methods.

        def __getitem__(self, index: int) -> Parameter: ...
        def __len__(self) -> int: ...
        def __iter__(self) -> Iterator[Parameter]: ...


@dataclass(frozen=True, eq=False)
class VectorParameter(_Operators):
    """A vector of parameters under one name; `Parameter(name, array)` creates it.

    Attributes:
        name: Name of the vector; its entries are named "name[0]", "name[1]", ….
        value: Values of the entries, (k,), unless a scene or flow sets others.
        entries: The entries, which act as scalar Parameters in forces and signals.
    """

    name: str
    value: Array
    entries: tuple[Parameter, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        _check_name(self.name)
        value = as_floats(self.value, f"the value of Parameter '{self.name}'")
        if value.ndim != 1 or not value.size:
            raise ShapeError(
                f"the value of Parameter '{self.name}' must be a number or have shape (k,) with "
                f"at least one entry, got shape {value.shape}"
            )
        if not is_finite(value):
            raise InputError(
                f"the value of Parameter '{self.name}' must be finite, got {brief(self.value)}"
            )
        object.__setattr__(self, "value", read_only(value.copy()))
        entries = [Parameter(f"{self.name}[{k}]", v) for k, v in enumerate(value.tolist())]
        for k, entry in enumerate(entries):
            vars(entry)["_place"] = (self, k)
        object.__setattr__(self, "entries", tuple(entries))

    @cached_property
    def symbol(self) -> ca.SX:
        """The CasADi symbols of the entries as a column (k, 1)."""
        import casadi as ca

        return ca.vertcat(*(entry.symbol for entry in self.entries))

    def __getitem__(self, index: Any) -> Any:
        try:
            return self.entries[index]
        except IndexError:
            raise IndexError(
                f"Parameter '{self.name}' has {len(self)} entries, got the index {index}"
            ) from None

    def __len__(self) -> int:
        return len(self.entries)

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self.entries)

    def __reduce__(self) -> tuple[Any, ...]:
        return Parameter, (self.name, self.value)


def _check_name(name: object) -> None:
    if not isinstance(name, str) or not name.strip():
        raise InputError(f"the name of a Parameter must be text, got {brief(name)}")


def by_name(parameters: Iterable[Parameter]) -> dict[str, Parameter | VectorParameter]:
    """Return the parameters that scenes and flows have, by name.

    Args:
        parameters: Parameters in forces, signals and events; several may be entries of one vector.
    Returns:
        The scalar parameters, and the whole vectors, in the order of first use.
    Raises:
        InputError: A vector or one of its entries has the name of another parameter.
    """
    named: dict[str, Parameter | VectorParameter] = {}
    for parameter in parameters:
        owner = parameter if parameter.place is None else parameter.place[0]
        other = named.setdefault(owner.name, owner)
        if other is not owner and VectorParameter in (type(other), type(owner)):
            _refuse_name(owner.name)
    for vector in [entry for entry in named.values() if isinstance(entry, VectorParameter)]:
        for entry in vector.entries:
            if entry.name in named:
                _refuse_name(entry.name)
    return named


def _refuse_name(name: str) -> None:
    raise InputError(
        f"two Parameters have the name '{name}', and one of them is a vector or an entry of a "
        "vector. Give them different names."
    )


def refuse_entry(name: object, known: Mapping[str, Parameter | VectorParameter], what: str) -> None:
    """Refuse the name of an entry of a vector.

    Args:
        name: The name.
        known: The parameters by name.
        what: The argument that has the name, for the message.
    Raises:
        InputError: The name is that of an entry.
    """
    for vector in known.values():
        if isinstance(vector, VectorParameter) and name in [entry.name for entry in vector]:
            raise InputError(
                f"{what}: {brief(name)} is an entry of the vector parameter '{vector.name}'. "
                f"Use '{vector.name}', with shape ({len(vector)},)."
            )


def value_in(values: Mapping[str, Any], parameter: Parameter) -> Any:
    """Return the value of a parameter.

    Args:
        values: Values of scalar and vector parameters by name.
        parameter: A scalar parameter, or an entry of a vector.
    Returns:
        Its value among `values`; its own value if `values` does not have it.
    """
    if parameter.place is None:
        return values.get(parameter.name, parameter.value)
    vector, index = parameter.place
    return values[vector.name][index] if vector.name in values else parameter.value


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
