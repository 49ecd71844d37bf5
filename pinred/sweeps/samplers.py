"""Samplers: uniform numbers of the points of a sweep, each of which depends on its index alone.

Points first … last − 1 have the same bits however a sweep is divided.  Sobol's sequence is a
linear function of the bits of the index, over the integers modulo 2.  So any point follows from
the points 0, 1, 2, 4, 8, …, and no sequence has to be advanced.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy
from numpy.typing import NDArray

from ..common.arrays import Array, as_floats
from ..common.errors import InputError, ShapeError
from ..common.names import brief
from ..scene.scene_options import Sampler
from .distributions import Distribution, Listed

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
    rows = [sequence.random(1)[0]]
    for bit in range(bits):
        skipped = 2**bit - sequence.num_generated
        if skipped:  # SciPy fails if nothing is skipped.
            sequence.fast_forward(skipped)
        rows.append(sequence.random(1)[0])
    integers = np.round(np.array(rows) * 2.0**_BITS).astype(np.int64)
    integers[1:] ^= integers[0]
    return integers


def _generator(seed: int) -> dict[str, np.random.Generator]:
    """Return the argument of SciPy's samplers for random numbers, "seed" before SciPy 1.15."""
    newer = tuple(map(int, scipy.__version__.split(".")[:2])) >= (1, 15)
    return {"rng" if newer else "seed": np.random.default_rng(seed)}
