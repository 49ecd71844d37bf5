"""Results as text and as notebook cards: the same rows, with correct numbers."""

from __future__ import annotations

import numpy as np
import pytest
from test_notebook_cards import StrictPage

import pinred
from pinred.common.summary import Summary

RODS = pinred.load("three_rods")
GAIT = pinred.Gait.fourier([0.5, 0.5], [[1.0, 0.0]], [[0.0, 1.0]])


def results() -> list[Summary]:
    """Return a phase with momentum, a best gait with limits, and a corrected integral."""
    return [
        pinred.phase(RODS, GAIT, [0.0, 0.0, 0.2]),
        pinred.optimise_gait(RODS, harmonics=1, starts=2, limits=1.5, speeds=20.0),
        pinred.corrected_integral(RODS, GAIT),
    ]


@pytest.fixture(scope="module")
def shown() -> list[Summary]:
    """Return the results once."""
    return results()


def test_text_and_card_have_the_same_rows(shown: list[Summary]) -> None:
    """At most twelve lines; the cells of the card are the rows of the text."""
    for result in shown:
        lines = repr(result).splitlines()
        assert len(lines) <= 12
        assert lines[0] == result.title()
        page = StrictPage(result._repr_html_())
        (table,) = page.tables
        assert [tuple(row) for row in table[1:]] == list(result.rows())
        for line, (label, text) in zip(lines[1:], result.rows(), strict=True):
            assert line.split() == [*label.split(), *text.split()]


def test_rows_have_the_numbers_of_the_result(shown: list[Summary]) -> None:
    """The pose, the merit and the integral can be read back."""
    phase, best, integral = shown
    assert isinstance(phase, pinred.Phase)
    assert isinstance(best, pinred.BestGait)
    pose = [float(word) for word in dict(phase.rows())["pose"].split()[1::2]]
    np.testing.assert_allclose(pose, phase.pose, rtol=1e-11)
    assert {"geometric", "dynamic", "samples"} <= dict(phase.rows()).keys()
    text = dict(best.rows())["rotation / length"]
    assert float(text) == pytest.approx(best.merit, rel=1e-9)
    assert dict(integral.rows())["relative error"].endswith("not trusted: above 0.05")
