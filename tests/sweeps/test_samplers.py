"""Samplers: points depend on their index alone, and agree with SciPy's sequences."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import qmc

import pinred
from pinred.common.arrays import Array
from pinred.scene.scene_options import SAMPLERS, Sampler
from pinred.sweeps.distributions import Distribution, PointSequence, grid_size

UNIT = pinred.Uniform(0.0, 1.0)
LAWS = (UNIT, pinred.Grid(0, 1, 100), pinred.Values(np.arange(50.0)))


def sample_points(
    sampler: Sampler, laws: Sequence[Distribution], first: int, last: int, points: int, seed: int
) -> Array:
    """Return the values of points first … last − 1."""
    return PointSequence.of(sampler, tuple(laws), points, seed).values(first, last)


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_points_do_not_depend_on_the_division(sampler: Sampler) -> None:
    """Any division into blocks gives the same bits."""
    laws = LAWS[1:] if sampler == "grid" else LAWS
    whole = sample_points(sampler, laws, 0, 5000, 5000, 3)
    edges = [0, 1, 2, 1000, 4095, 4097, 5000]
    parts = [
        sample_points(sampler, laws, first, last, 5000, 3)
        for first, last in reversed(list(pairwise(edges)))
    ]
    np.testing.assert_array_equal(np.concatenate(parts[::-1]), whole)
    if sampler != "grid":
        assert not np.array_equal(whole, sample_points(sampler, laws, 0, 5000, 5000, 4))
    if sampler in ("sobol", "random"):
        np.testing.assert_array_equal(whole, sample_points(sampler, laws, 0, 5000, 9999, 3))


def test_sobol_points_are_scipys() -> None:
    """Points far into the sequence equal those of SciPy's generator."""
    sequence = qmc.Sobol(3, rng=np.random.default_rng(7))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # about numbers that are no power of two
        first = sequence.random(3000)
        sequence.fast_forward(100_000 - 3000)
        far = sequence.random(500)
    for start, judge in ((0, first), (100_000, far)):
        points = sample_points("sobol", [UNIT] * 3, start, start + len(judge), 200_000, 7)
        np.testing.assert_array_equal(points, judge)


def test_latin_hypercube_has_one_point_in_each_row() -> None:
    """Each of N intervals contains one point, along every coordinate."""
    points = sample_points("latin", [UNIT, UNIT], 0, 200, 200, 1)
    for column in points.T:
        assert sorted((column * 200).astype(int)) == list(range(200))


def test_grid_has_all_combinations() -> None:
    """The last number varies fastest."""
    laws = (pinred.Grid(0, 1, 2), pinred.Values([5, 6, 7]))
    assert grid_size(laws) == 6
    expected = [[x, y] for x in (0, 1) for y in (5, 6, 7)]
    assert sample_points("grid", laws, 0, 6, 6, 0).tolist() == expected
