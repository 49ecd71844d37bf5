"""Distributions of the numbers that a sweep varies, as functions of uniform numbers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array, as_floats, positive, read_only, whole
from ..common.errors import InputError

_TINY = 2.0**-64  # least distance of a uniform number from 0 and 1 in normal distributions


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


class Listed(Distribution):
    """A distribution of equally probable listed values, which a grid takes in order."""

    @property
    @abstractmethod
    def listed(self) -> Array:
        """The values, (count,)."""

    def at(self, u: Array) -> Array:
        """Return listed values; see Distribution."""
        values = self.listed
        return values[np.minimum((u * len(values)).astype(int), len(values) - 1)]


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
        return np.asarray(self.low + (self.high - self.low) * u)


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
        return np.asarray(self.low * (self.high / self.low) ** u)


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

        return np.asarray(self.mean + self.deviation * ndtri(np.clip(u, _TINY, 1.0 - 2.0**-53)))


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
        whole(self.count, "count of Grid", 2)

    @property
    def listed(self) -> Array:
        """The values, (count,)."""
        return np.linspace(self.low, self.high, self.count)


@checks_arguments
@dataclass(frozen=True, eq=False)
class Values(Listed):
    """Given values.

    Attributes:
        values: The values, (count,).
    """

    values: ArrayLike

    def __post_init__(self) -> None:
        values = as_floats(self.values, "values of Values")
        if values.ndim != 1 or not len(values) or not np.isfinite(values).all():
            raise InputError("values of Values must be a list of finite numbers")
        object.__setattr__(self, "values", read_only(values.copy()))

    @property
    def listed(self) -> Array:
        """The values, (count,)."""
        return np.asarray(self.values)


def _increasing(low: float, high: float, name: str) -> None:
    if not (np.isfinite([low, high]).all() and low < high):
        raise InputError(f"{name} needs finite numbers low < high, got {low} and {high}")
