"""Numbers of forces as symbols, so that kernels need no new compilation when they change."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from ..common.arrays import Array, read_only
from ..common.errors import InputError
from ..common.parameter import Affine, Parameter

_NEAR = 1e-2  # relative variation of the numbers of formulas when kernels are tested


class ForceNumbers:
    """The symbols and values of all numbers in forces and signals.

    Attributes:
        symbols: One symbol per number, in the order of creation.
    """

    def __init__(self) -> None:
        """Start without numbers."""
        self.symbols: list[ca.SX] = []
        self._values: list[float] = []
        self._slopes: list[tuple[int, Parameter, float]] = []
        self._slot_of: dict[Parameter, int] = {}
        self._in_formulas: list[int] = []

    def __len__(self) -> int:
        return len(self._values)

    def symbol(self, value: Any) -> ca.SX:
        """Return the symbol of a number, of a Parameter, or of an Affine function of some."""
        slot = len(self._values)
        if isinstance(value, Parameter):
            if value not in self._slot_of:
                self._slot_of[value] = slot
                self._slopes.append((slot, value, 1.0))
                self._values.append(value.value)
                self.symbols.append(value.symbol)
            return self.symbols[self._slot_of[value]]
        if isinstance(value, Affine):
            self._in_formulas.append(slot)
            self._slopes += [
                (slot, parameter, weight) for parameter, weight in value.weights.items()
            ]
            value = value.value
        self._values.append(value)
        self.symbols.append(ca.SX.sym(f"p{slot}"))
        return self.symbols[-1]

    @property
    def values(self) -> Array:
        """Values of the numbers, (p,)."""
        return read_only(np.array(self._values))

    @property
    def in_formulas(self) -> list[int]:
        """Indices of the numbers that belong to formulas or tables."""
        return self._in_formulas

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the Parameters among the numbers.

        Raises:
            InputError: Two of them have the same name.
        """
        parameters = list(dict.fromkeys(parameter for _, parameter, _ in self._slopes))
        names = [parameter.name for parameter in parameters]
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            raise InputError(
                f"two Parameters are called '{twice[0]}'; make one and use it in both places, or "
                "give them different names"
            )
        return tuple(parameters)

    def slopes(self, parameters: tuple[Parameter, ...]) -> Array:
        """Return ∂numbers/∂parameters, (p, parameters), which is constant."""
        slopes = np.zeros((len(self), len(parameters)))
        for slot, parameter, slope in self._slopes:
            slopes[slot, parameters.index(parameter)] = slope
        return slopes


def random_numbers(values: Array, in_formulas: list[int], rng: np.random.Generator) -> Array:
    """Return random numbers to test kernels with; those of formulas are near their values.

    Args:
        values: Values of the numbers, (p,).
        in_formulas: Indices of the numbers of formulas.
        rng: Random generator.
    Returns:
        Numbers, (p,).
    """
    numbers = rng.normal(size=len(values))
    numbers[in_formulas] = values[in_formulas] * (1.0 + _NEAR * numbers[in_formulas])
    return numbers
