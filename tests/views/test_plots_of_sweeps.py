"""Figures of sweeps show the numbers of their datasets."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

xarray = pytest.importorskip("xarray")

import pinred  # noqa: E402
from pinred.cli.command_line import main  # noqa: E402


@pytest.fixture(scope="module")
def result() -> Any:
    """Artificial results: turn = mass + 10 gain on a grid, with one failed point."""
    mass, gain = (values.ravel() for values in np.meshgrid(np.arange(5.0), [0.0, 1.0, 2.0]))
    turn = mass + 10.0 * gain
    turn[0] = np.nan
    energy = turn[:, None] + np.arange(4.0)
    return xarray.Dataset(
        {"turn": ("point", turn, {"units": "rad"}), "e": (("point", "t"), energy),
         "status": ("point", np.ones(15, np.uint8))},
        {"a.mass": ("point", mass, {"units": "kg"}), "gain": ("point", gain), "t": np.arange(4.0)},
        {"robot": "made_up"},
    )  # fmt: skip


def test_histogram_counts_all_points(result: Any) -> None:
    """The bars contain all finite points; labels have units."""
    (axes,) = pinred.plot(result, "histogram", output="turn").axes
    assert sum(bar.get_height() for bar in axes.patches) == 14  # type: ignore[attr-defined]
    assert axes.get_xlabel() == "turn [rad]"
    assert axes.lines[1].get_xdata()[0] == np.nanmedian(result.turn)  # type: ignore[index]
    turn = result.turn.values[1:]
    low, high = np.percentile(turn, [5, 95])
    legend = axes.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == [
        f"5 %: {low:.4g}", f"median: {np.median(turn):.4g}", f"95 %: {high:.4g}",
        f"mean: {sum(turn) / 14:.4g} ± {np.sqrt(sum((turn - turn.mean()) ** 2) / 13):.2g}",
    ]  # fmt: skip


def test_scatter_has_a_panel_for_each_number(result: Any) -> None:
    """The dots are the finite points."""
    figure = pinred.plot(result, "scatter", output="turn")
    assert [axes.get_xlabel() for axes in figure.axes] == ["a.mass [kg]", "gain"]
    x, y = figure.axes[0].lines[0].get_data()
    np.testing.assert_array_equal(x, result["a.mass"][1:])
    np.testing.assert_array_equal(y, result["turn"][1:])


def test_heatmap_shows_means_over_two_numbers(result: Any) -> None:
    """Each value of the grid is one cell."""
    axes, _ = pinred.plot(result, "heatmap", output="turn", numbers=["gain", "a.mass"]).axes
    cells: Any = np.ma.filled(np.ma.asarray(axes.collections[0].get_array()), np.nan).reshape(5, 3)
    expected = np.arange(5.0)[:, None] + 10.0 * np.arange(3.0)
    expected[0, 0] = np.nan
    np.testing.assert_allclose(cells, expected, rtol=1e-15)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("gain", "a.mass [kg]")


def test_quantiles_are_over_time_or_a_number(result: Any) -> None:
    """The line is the median."""
    (axes,) = pinred.plot(result, "quantiles", output="e").axes
    medians = np.asarray(axes.lines[0].get_ydata(), dtype=float)
    np.testing.assert_allclose(medians, np.nanmedian(result.e, axis=0))
    (axes,) = pinred.plot(result, "quantiles", output="turn", numbers=["gain"]).axes
    line = np.array(axes.lines[0].get_data(), dtype=float)
    np.testing.assert_allclose(line, [[0.0, 1.0, 2.0], [2.5, 12.0, 22.0]])


def test_unknown_names_are_rejected(result: Any) -> None:
    """The message lists the valid names."""
    for options, words in (
        ({"output": "trn"}, "did you mean 'turn'"),
        ({"output": "turn", "numbers": ["gan"]}, "did you mean 'gain'"),
    ):
        with pytest.raises(pinred.InputError, match=words):
            pinred.plots.heatmap(result, **options)
    with pytest.raises(pinred.InputError, match="expected two varied numbers, got gain"):
        pinred.plots.heatmap(result, output="turn", numbers=["gain"])
    with pytest.raises(pinred.InputError, match=r"results of pinred\.sweep"):
        pinred.plots.histogram(xarray.Dataset())


def test_command_draws_a_store(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """All kinds are drawn from a store; other sources are refused."""
    pytest.importorskip("zarr")
    scene = pinred.Scene(system=pinred.load("elroys_beanie"), duration=1.0)
    store = tmp_path / "s.zarr"
    vary = {"x0.beanie": "Grid(-1, 1, 5)", "xdot0.beanie": [0.0, 0.5]}
    pinred.sweep(scene, vary, outputs=["pose.theta"], store=store)
    out = str(tmp_path / "a.png")
    kinds = "histogram,scatter,heatmap,quantiles"
    assert main(["plot", str(store), "--kind", kinds, "--out", out]) == 0
    assert len(list(tmp_path.glob("a_*.png"))) == 4
    words = ["--numbers", "xdot0.beanie,x0.beanie", "--output", "pose.theta"]
    assert main(["plot", str(store), "--kind", "heatmap", "--out", out, *words]) == 0
    assert main(["plot", "falling_cat", "--kind", "heatmap", "--out", out]) == 2
    assert main(["plot", str(store), "--kind", "shape", "--out", out]) == 2
    assert "drawn of a store of `pinred sweep`" in capsys.readouterr().err
