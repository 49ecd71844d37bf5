"""Samplers: uniform numbers of the points of a sweep, each of which depends on its index alone."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import lru_cache
from typing import Literal, TypeAlias, get_args

import numpy as np
import scipy

from ..common.arrays import Array
from .distributions import Distribution, Listed

Sampler: TypeAlias = Literal["sobol", "latin", "random", "grid"]
SAMPLERS: tuple[Sampler, ...] = get_args(Sampler)
_DRAWN = 4096  # random points that one generator draws, from a seed of its own
MOST_SOBOL = 2**30  # SciPy's sequence of 30 bits ends there


def values_of(
    sampler: Sampler, laws: Sequence[Distribution], first: int, last: int, points: int, seed: int
) -> Array:
    """Return the values of points first … last − 1.

    Args:
        sampler: Name of the sampler.
        laws: Distribution of each number.
        first: Index of the first point.
        last: Index after the last point.
        points: Number of points of the sweep, on which only "latin" depends.
        seed: Seed of the sampler.
    Returns:
        Values, (last − first, number of laws).
    """
    if sampler == "grid":
        return _grid(laws, first, last)
    u = _uniform(sampler, len(laws), first, last, points, seed)
    return np.stack([law.at(column) for law, column in zip(laws, u.T, strict=True)], axis=1)


def grid_size(laws: Sequence[Distribution]) -> int:
    """Return the number of points of a grid of listed values."""
    return int(np.prod([len(law.listed) for law in laws if isinstance(law, Listed)]))


def _grid(laws: Sequence[Distribution], first: int, last: int) -> Array:
    """Return points of the product of all lists, of which the last one varies fastest."""
    lists = [law.listed for law in laws if isinstance(law, Listed)]
    places = np.unravel_index(np.arange(first, last), [len(values) for values in lists])
    return np.stack([values[k] for values, k in zip(lists, places, strict=True)], axis=1)


def _uniform(
    sampler: Sampler, count: int, first: int, last: int, points: int, seed: int
) -> Array:
    """Return uniform numbers, (last − first, count)."""
    if sampler == "sobol":
        from scipy.stats import qmc

        sequence = qmc.Sobol(count, **_generator(seed))
        if first:
            sequence.fast_forward(first)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "The balance properties", UserWarning)
            return np.asarray(sequence.random(last - first))
    if sampler == "latin":
        return _latin(count, points, seed)[first:last]
    chunks = [
        np.random.default_rng([seed, k]).random((_DRAWN, count))
        for k in range(first // _DRAWN, -(-last // _DRAWN))
    ]
    start = first - first // _DRAWN * _DRAWN
    return np.concatenate(chunks)[start : start + last - first]


@lru_cache(maxsize=1)
def _latin(count: int, points: int, seed: int) -> Array:
    """Return all points of a Latin hypercube, (points, count)."""
    from scipy.stats import qmc

    return np.asarray(qmc.LatinHypercube(count, **_generator(seed)).random(points))


def _generator(seed: int) -> dict[str, np.random.Generator]:
    """Return the argument of SciPy's samplers for random numbers, "seed" before SciPy 1.15."""
    newer = tuple(map(int, scipy.__version__.split(".")[:2])) >= (1, 15)
    return {"rng" if newer else "seed": np.random.default_rng(seed)}
