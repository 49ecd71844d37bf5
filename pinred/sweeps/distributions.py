"""Distributions of the numbers that a sweep varies, as functions of uniform numbers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..common.argument_kinds import build_from_text, checks_arguments
from ..common.arrays import Array, as_floats, positive, read_only, whole
from ..common.errors import InputError
from ..common.names import brief, quoted

# Least distances of a uniform number from 0 and from 1, so that normal values are finite.
_ABOVE_0, _BELOW_1 = 2.0**-64, 2.0**-53
_MOST_LISTED = 10**8  # largest number of values of a Grid


def _levels(u: Any) -> Array:
    """Return numbers from 0 to 1 as an array of floats.  Raises InputError for others."""
    levels = as_floats(u, "u")
    if not ((levels >= 0.0) & (levels <= 1.0)).all():
        raise InputError(f"u: expected numbers from 0 to 1, got {brief(u)}")
    return levels


@checks_arguments
class Distribution(ABC):
    """A distribution of one number."""

    @abstractmethod
    def at(self, u: Array) -> Array:
        """Return the values whose cumulative probabilities are u.

        Args:
            u: Numbers from 0 to 1, (N,).
        Returns:
            Values, (N,).
        """


@checks_arguments
class Listed(Distribution):
    """A distribution of equally probable listed values, which a grid takes in order."""

    @property
    @abstractmethod
    def listed(self) -> Array:
        """The values, (count,)."""

    def at(self, u: Array) -> Array:
        """Return listed values; see Distribution."""
        values = self.listed
        numbers = (_levels(u) * len(values)).astype(int)
        return np.asarray(values[np.minimum(numbers, len(values) - 1)])


@checks_arguments
@dataclass(frozen=True)
class Uniform(Distribution):
    """Equal probability between two numbers.

    Attributes:
        low: Lowest value.
        high: Highest value.
    """

    low: float
    high: float

    def __post_init__(self) -> None:
        _increasing(self.low, self.high, "Uniform")

    def at(self, u: Array) -> Array:
        """Return values; see Distribution."""
        return np.asarray(self.low + (self.high - self.low) * _levels(u))


@checks_arguments
@dataclass(frozen=True)
class LogUniform(Distribution):
    """Equal probability of equal ratios between two positive numbers.

    Attributes:
        low: Lowest value, above zero.
        high: Highest value.
    """

    low: float
    high: float

    def __post_init__(self) -> None:
        positive(self.low, "low of LogUniform")
        _increasing(self.low, self.high, "LogUniform")

    def at(self, u: Array) -> Array:
        """Return values; see Distribution."""
        return np.asarray(self.low * (self.high / self.low) ** _levels(u))


@checks_arguments
@dataclass(frozen=True)
class Normal(Distribution):
    """The normal distribution.  Unphysical draws become rejected points.

    Attributes:
        mean: Mean.
        deviation: Standard deviation, above zero.
    """

    mean: float
    deviation: float

    def __post_init__(self) -> None:
        positive(self.deviation, "deviation of Normal")
        if not np.isfinite(self.mean):
            raise InputError(f"mean of Normal must be finite, got {self.mean}")

    def at(self, u: Array) -> Array:
        """Return values; see Distribution."""
        from scipy.special import ndtri

        levels = np.clip(_levels(u), _ABOVE_0, 1.0 - _BELOW_1)
        return np.asarray(self.mean + self.deviation * ndtri(levels))


@checks_arguments
@dataclass(frozen=True)
class Grid(Listed):
    """Equally spaced values, both ends included.

    Attributes:
        low: Lowest value.
        high: Highest value.
        count: Number of values, at least two.
    """

    low: float
    high: float
    count: int

    def __post_init__(self) -> None:
        _increasing(self.low, self.high, "Grid")
        whole(self.count, "count of Grid", 2, _MOST_LISTED)

    @property
    def listed(self) -> Array:
        """The values, (count,)."""
        return np.linspace(self.low, self.high, self.count)


@checks_arguments
@dataclass(frozen=True, eq=False, repr=False)
class Values(Listed):
    """Listed values, equally probable.

    Attributes:
        values: The values, (count,).
    """

    values: ArrayLike

    def __post_init__(self) -> None:
        values = as_floats(self.values, "values of Values")
        if values.ndim != 1 or not len(values) or not np.isfinite(values).all():
            raise InputError("values of Values must be a list of finite numbers")
        object.__setattr__(self, "values", read_only(values.copy()))

    def __repr__(self) -> str:
        return f"Values({self.listed.tolist()})"

    @property
    def listed(self) -> Array:
        """The values, (count,)."""
        return np.asarray(self.values)


DISTRIBUTIONS: Mapping[str, type[Distribution]] = {
    kind.__name__: kind for kind in (Uniform, LogUniform, Normal, Grid, Values)
}


def parse_distribution(value: Any, key: str) -> Distribution:
    """Convert a distribution, a text such as "Uniform(0.5, 2)" or "[1, 2]", or a list of values.

    Args:
        value: The distribution.
        key: Name of the number that varies, for messages.
    Returns:
        The distribution.
    Raises:
        InputError: The value has another form.
    """
    if isinstance(value, Distribution):
        return value
    if isinstance(value, str):
        try:
            kinds: Mapping[str, Any] = DISTRIBUTIONS
            text = f"Values({value})" if value.lstrip().startswith("[") else value
            law: Distribution = build_from_text(text, kinds, "distribution", "", "Uniform(0.5, 2)")
        except InputError as error:
            raise InputError(f"vary: {quoted(key)}: {error}") from None
        return law
    if isinstance(value, (list, tuple, range, np.ndarray)):
        return Values(value)
    raise InputError(
        f"vary: {quoted(key)}: expected a distribution ({', '.join(DISTRIBUTIONS)}), one of these "
        f"as text, or a list of values, got {brief(value)}"
    )


def _increasing(low: float, high: float, name: str) -> None:
    if not (np.isfinite([low, high]).all() and low < high):
        raise InputError(f"{name} needs finite numbers low < high, got {low} and {high}")
