"""Figures look like stored small pictures, within a tolerance."""

from __future__ import annotations

import pytest
from pictures import FIGURES, FOLDER, baseline, mismatch, picture

ENOUGH = 70.0  # pixels; matplotlib 3.9 makes 55 at most of what 3.11 drew
SMALL = ("start", "_far", "_near", "levels of the energy")  # or hidden by others


@pytest.mark.parametrize("name", FIGURES)
@pytest.mark.sampled
def test_figure_equals_picture(name: str) -> None:
    """Without any one of its curves the figure differs."""
    figure, expected = FIGURES[name](), baseline(name)
    assert mismatch(picture(figure), expected) < ENOUGH
    curves = [
        line
        for axes in figure.axes
        for line in axes.lines
        if len(line.get_xdata()) and line.get_label() not in SMALL  # type: ignore[arg-type]
    ]
    assert curves
    for curve in curves:
        curve.set_visible(False)
        assert mismatch(picture(figure), expected) > 2.0 * ENOUGH, curve.get_label()
        curve.set_visible(True)
    # But it may stand elsewhere by a pixel.
    assert mismatch(expected[2:, :-2], expected[1:-1, 1:-1]) < ENOUGH


def test_field_with_other_colours_differs() -> None:
    """A field with other colours is another picture."""
    figure = FIGURES["curvature"]()
    figure.axes[0].collections[0].set_cmap("viridis")
    assert mismatch(picture(figure), baseline("curvature")) > 1000.0


def test_pictures_are_small_and_used() -> None:
    """Every picture belongs to a figure."""
    files = list(FOLDER.iterdir())
    assert {path.stem for path in files} == set(FIGURES)
    assert sum(path.stat().st_size for path in files) < 300_000
