"""Results as text and as notebook cards: the same rows, with correct numbers."""

from __future__ import annotations

import numpy as np
import pytest
from test_notebook_cards import StrictPage

import pinred
from pinred.common.html import Summary

RODS = pinred.load("three_rods")
GAIT = pinred.Gait.fourier([0.5, 0.5], [[1.0, 0.0]], [[0.0, 1.0]])


def results() -> list[Summary]:
    """Return connections, a phase with momentum, a best gait, and a corrected integral."""
    flying = pinred.Connection.mechanical(pinred.load("diver"))
    tilted = pinred.load("double_spherical_pendulum", gravity=(1.0, 0.0, -9.0))
    return [
        flying,
        flying.in_chart(),
        pinred.Connection.mechanical(tilted),
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
    connection, in_chart, tilted, phase, best, integral = shown
    spaces = dict(connection.rows())
    assert spaces["group"] == "SE3, r = 6"
    assert spaces["shape space"].startswith("m = 9: ")
    assert spaces["shape space"].endswith(", …")
    assert spaces["metric"] == "on shape space"
    assert "momenta" not in spaces
    assert dict(tilted.rows())["momenta"].startswith("not conserved: gravity (1, 0, -9) breaks")
    assert dict(in_chart.rows())["coordinates"] == "in rotation vectors"
    assert isinstance(phase, pinred.Phase)
    assert isinstance(best, pinred.BestGait)
    pose = [float(word) for word in dict(phase.rows())["pose"].split()[1::2]]
    np.testing.assert_allclose(pose, phase.pose, rtol=1e-11)
    assert {"geometric", "dynamic", "samples"} <= dict(phase.rows()).keys()
    text = dict(best.rows())["rotation / length [rad/(m √kg)]"]
    assert float(text) == pytest.approx(best.merit, rel=1e-9)
    assert dict(integral.rows())["relative error"].endswith("not trusted: above 0.05")
