"""Distributions against SciPy's quantile functions, and their texts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats

import pinred
from pinred.sweeps.distributions import DISTRIBUTIONS, parse_distribution

U = np.array([0.0, 1e-9, 0.25, 0.5, 0.875, 1.0 - 1e-9, 1.0])
LAWS: list[tuple[pinred.Distribution, Any]] = [
    (pinred.Uniform(-0.5, 2.0), stats.uniform(-0.5, 2.5)),
    (pinred.LogUniform(0.01, 10.0), stats.loguniform(0.01, 10.0)),
    (pinred.Normal(1.0, 0.1), stats.norm(1.0, 0.1)),
]


@pytest.mark.parametrize(("law", "judge"), LAWS, ids=lambda value: type(value).__name__)
def test_values_are_quantiles(law: pinred.Distribution, judge: Any) -> None:
    """Values agree with SciPy's quantiles; those of Normal are finite even at 0 and 1."""
    values = law.at(U)
    assert np.isfinite(values).all()
    np.testing.assert_allclose(values[1:-1], judge.ppf(U[1:-1]), rtol=1e-12)
    assert (np.diff(values) > 0.0).all()


def test_listed_values_are_equally_probable() -> None:
    """Each value of a grid has an equal share, both ends included."""
    grid = pinred.Grid(-1, 1, 5)
    assert grid.listed.tolist() == [-1.0, -0.5, 0.0, 0.5, 1.0]
    values = grid.at((np.arange(1000) + 0.5) / 1000)
    assert [int((values == value).sum()) for value in grid.listed] == [200] * 5
    assert pinred.Values([3, 1]).at(np.array([0.0, 0.49, 0.5, 1.0])).tolist() == [3, 3, 1, 1]


def test_text_and_object_are_equal() -> None:
    """The text of a distribution gives the distribution, and a list gives Values."""
    for text in ("Uniform(0.5, 2)", "LogUniform(low=1, high=3)", "Normal(1, 0.1)", "Grid(0, 1, 3)"):
        kind = DISTRIBUTIONS[text.partition("(")[0]]
        law = parse_distribution(text, "gain")
        assert type(law) is kind
        assert parse_distribution(repr(law), "gain") == law
    for value in ([1, 2], "Values([1, 2])", "[1, 2]", np.array([1.0, 2.0])):
        listed = parse_distribution(value, "gain")
        assert isinstance(listed, pinred.Values)
        assert listed.listed.tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("Unifrm(0, 1)", "did you mean 'Uniform'"),
        ("Uniform(0)", r"needs a high, as in Uniform\(0.5, 2\)"),
        ("Uniform(0, 1, 2)", "its options are low, high"),
        ("Uniform(1, 0)", "low < high"),
        ("__import__('os').system('true')", "must be a name, or a name with options"),
        ("Normal(0, 0)", "deviation of Normal must be"),
        ("Grid(0, 1, 1)", "count of Grid"),
        ("LogUniform(0, 1)", "low of LogUniform"),
        ([], "list of finite numbers"),
        (3.0, "expected a distribution"),
    ],
)
def test_invalid_distributions_are_rejected(value: Any, words: str) -> None:
    """The message names the problem and a remedy."""
    with pytest.raises(pinred.InputError, match=words):
        parse_distribution(value, "gain")
