"""Distributions of the numbers that a sweep varies, and samplers of its points.

A distribution is a function of uniform numbers, which a sampler returns for each point from the
index of the point alone.  Points first … last − 1 have the same bits however a sweep is divided.
Sobol's sequence is a linear function of the bits of the index, over the integers modulo 2.  So any
point follows from the points 0, 1, 2, 4, 8, …, and no sequence has to be advanced.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from ..common.argument_kinds import build_from_text, checks_arguments
from ..common.arrays import Array, as_floats, positive, read_only, whole
from ..common.errors import InputError, ShapeError
from ..common.names import brief, quoted
from ..scene.scene_options import Sampler

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
        """Return the listed values with cumulative probabilities u; see Distribution."""
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
        """Return the values with cumulative probabilities u; see Distribution."""
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
        """Return the values with cumulative probabilities u; see Distribution."""
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
        """Return the values with cumulative probabilities u; see Distribution."""
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


_DRAWN = 4096  # number of random points that share a generator
_BITS = 30  # binary digits of the numbers in SciPy's Sobol sequence
MOST_SOBOL = 2**_BITS  # number of points of this sequence


@dataclass(frozen=True, eq=False)
class PointSequence:
    """The points of a sweep; it needs no other package on the machines that compute them.

    Attributes:
        sampler: Name of the sampler.
        laws: Distribution of each number.
        points: Number of points; only the values of "latin" depend on it.
        seed: Seed of the sampler.
        directions: Integers of the sampler "sobol", see sobol_directions; None for the others.
    """

    sampler: Sampler
    laws: tuple[Distribution, ...]
    points: int
    seed: int
    directions: NDArray[np.int64] | None

    @classmethod
    def of(
        cls, sampler: Sampler, laws: tuple[Distribution, ...], points: int, seed: int
    ) -> PointSequence:
        """Return the points of a sweep; see the attributes."""
        directions = None
        if sampler == "sobol":
            directions = sobol_directions(len(laws), (points - 1).bit_length(), seed)
        return cls(sampler, laws, points, seed, directions)

    def values(self, first: int, last: int) -> Array:
        """Return the values of points first … last − 1, (last − first, number of laws).

        Raises an InputError if a distribution returns other than finite numbers.
        """
        if self.sampler == "grid":
            return _sample_grid(self.laws, first, last)
        if self.directions is not None:
            u = _sample_sobol(self.directions, first, last)
        elif self.sampler == "latin":
            u = _latin_hypercube(len(self.laws), self.points, self.seed)[first:last]
        else:
            u = _sample_random(len(self.laws), first, last, self.seed)
        columns = zip(self.laws, u.T, strict=True)
        return np.stack([_values_of(law, column) for law, column in columns], axis=1)


def _values_of(law: Distribution, u: Array) -> Array:
    values = as_floats(law.at(u), f"values of {brief(law)}")
    if values.shape != u.shape:
        raise ShapeError(
            f"vary: expected {len(u)} values of {brief(law)}, one for each number u, got shape "
            f"{values.shape}"
        )
    if not (finite := np.isfinite(values)).all():
        k = int(np.argmin(finite))
        raise InputError(
            f"vary: expected finite values of {brief(law)}, got {values[k]} at u = {u[k]}"
        )
    return values


def grid_size(laws: Iterable[Distribution]) -> int:
    """Return the number of points of a grid of listed values."""
    size = 1
    for law in laws:
        size *= len(law.listed) if isinstance(law, Listed) else 1
    return size


def _sample_grid(laws: Iterable[Distribution], first: int, last: int) -> Array:
    """Return points of the product of all lists; the last number varies fastest."""
    lists = [law.listed for law in laws if isinstance(law, Listed)]
    places = np.unravel_index(np.arange(first, last), [len(values) for values in lists])
    return np.stack([values[k] for values, k in zip(lists, places, strict=True)], axis=1)


def _sample_random(count: int, first: int, last: int, seed: int) -> Array:
    start = first // _DRAWN
    drawn = [
        np.random.default_rng([seed, k]).random((_DRAWN, count))
        for k in range(start, -(-last // _DRAWN))
    ]
    return np.concatenate(drawn)[first - start * _DRAWN : last - start * _DRAWN]


@lru_cache(maxsize=1)
def _latin_hypercube(count: int, points: int, seed: int) -> Array:
    """Return all points of a Latin hypercube, (points, count): one in each of N intervals."""
    rng = np.random.default_rng(seed)
    places = rng.permuted(np.repeat(np.arange(points)[:, None], count, axis=1), axis=0)
    return np.asarray((places + rng.random((points, count))) / points)


def _sample_sobol(directions: NDArray[np.int64], first: int, last: int) -> Array:
    index = np.arange(first, last)
    integers = np.repeat(directions[:1], len(index), axis=0)
    for bit, direction in enumerate(directions[1:]):
        integers ^= ((index >> bit) & 1)[:, None] * direction
    return np.asarray(integers * 2.0**-_BITS)


def sobol_directions(count: int, bits: int, seed: int) -> NDArray[np.int64]:
    """Return point 0 and its differences (exclusive or) from the points 1, 2, 4, …, as integers.

    Args:
        count: Number of coordinates.
        bits: Number of bits of the largest index.
        seed: Seed of the scrambling.
    Returns:
        Integers below 2^_BITS, (1 + bits, count).
    """
    from scipy.stats import qmc

    sequence = qmc.Sobol(count, **_generator(seed))
    points = [sequence.random(1)[0]]
    for bit in range(bits):
        skipped = 2**bit - sequence.num_generated
        if skipped:  # SciPy fails if nothing is skipped.
            sequence.fast_forward(skipped)
        points.append(sequence.random(1)[0])
    integers = np.round(np.array(points) * 2.0**_BITS).astype(np.int64)
    integers[1:] ^= integers[0]
    return integers


def _generator(seed: int) -> dict[str, np.random.Generator]:
    """Return the argument of SciPy's samplers for random numbers, "seed" before SciPy 1.15."""
    newer = tuple(map(int, scipy.__version__.split(".")[:2])) >= (1, 15)
    return {"rng" if newer else "seed": np.random.default_rng(seed)}
