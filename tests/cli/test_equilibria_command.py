"""`pinred equilibria`: tables, diagrams, playback of modes, and errors."""

from __future__ import annotations

from pathlib import Path

import commands
import numpy as np
import pytest

import pinred
from pinred import plots
from pinred.cli.command_line import main


def test_equilibria_prints_the_table_of_python(capsys: pytest.CaptureFixture[str]) -> None:
    """The output is the text of the Python result."""
    assert main(["equilibria", "rigid_body", "--momentum", "1", "--starts", "20"]) == 0
    found = pinred.relative_equilibria(pinred.load("rigid_body"), momentum=1.0, starts=20)
    assert capsys.readouterr().out == f"{found}\n"


def test_equilibria_options_match_python(capsys: pytest.CaptureFixture[str]) -> None:
    """Momenta of wheels and springs have the effect they have in Python."""
    arguments = ("--momentum", "0.5", "--starts", "30", "--cyclic", "wheel_x=0.3,wheel_y=-0.2")
    spring = ("--springs", "panel_hinge=0.5,0.2", "--seed", "3")
    assert main(["equilibria", "reaction_wheel_satellite", *arguments, *spring]) == 0
    found = pinred.relative_equilibria(
        pinred.load("reaction_wheel_satellite"), momentum=0.5, starts=30, seed=3,
        cyclic={"wheel_x": 0.3, "wheel_y": -0.2}, springs={"panel_hinge": (0.5, 0.2)},
    )  # fmt: skip
    assert capsys.readouterr().out == f"{found}\n"


@pytest.mark.by_hand
def test_equilibria_writes_diagram_and_played_mode(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Branches give a figure, a mode gives an HTML page."""
    figure, page = tmp_path / "cart.png", tmp_path / "mode.html"
    ends = ("--momentum", "-1,1", "--starts", "8", "--out", str(figure))
    assert main(["equilibria", "cartpole", *ends]) == 0
    assert "2 branches of relative equilibria" in capsys.readouterr().out
    assert figure.stat().st_size > 5000
    shown = ("--play", "0", "--mode", "0", "--duration", "0.5", "--out", str(page), "--starts", "8")
    assert main(["equilibria", "cartpole", "--momentum", "0", *shown]) == 0
    assert "playing 0, pole_pivot=0: stable" in capsys.readouterr().out
    assert page.stat().st_size > 1e5


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--momentum", "1,2,3"), "takes J, or LOW,HIGH"),
        (("--momentum", "x"), "numbers separated by commas"),
        (("--momentum", "1", "--mode", "0"), "--mode requires --play"),
        (("--momentum", "1", "--out", "a.png"), "--out requires a range"),
        (("--momentum", "1,2", "--play", "0"), "a single momentum"),
        (("--momentum", "1,2", "--joint", "bend"), "--joint requires the diagram"),
        (("--momentum", "1", "--cyclic", "0.3"), "JOINT=MOMENTUM"),
        (("--momentum", "1", "--cyclic", "bend=0.3"), "is not cyclic"),
        (("--momentum", "1", "--play", "0", "--out", "a.csv"), "must be .html"),
        (("--momentum", "1", "--starts", "2", "--play", "99"), "got 99"),
        ((), "--momentum"),
    ],
)
def test_equilibria_bad_input_is_one_line(
    capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], words: str
) -> None:
    """The exit code is 2."""
    assert words in commands.refused(capsys, "equilibria", "falling_cat", *arguments)


def test_diagram_draws_branches_over_momentum() -> None:
    """Stable branches are solid lines; --joint sets the vertical axis."""
    found = pinred.branches(pinred.load("cartpole"), momentum=(-1.0, 1.0), starts=8, step=0.5)
    figure = plots.branches(found)
    (axes,) = figure.axes
    assert axes.get_xlabel() == "momentum [N·s]"
    assert axes.get_ylabel() == "amended potential [J]"
    for k in range(2):
        wanted = [(p.momentum, p.amended_potential) for p in found.branch(k)]
        np.testing.assert_array_equal(np.asarray(axes.lines[k].get_xydata()), wanted)
    legend = axes.get_legend()
    assert legend is not None
    texts = [text.get_text() for text in legend.get_texts()]
    assert texts == ["stable: a minimum", "unstable: index odd"]
    (axes,) = pinred.plot(found, "branches", joint="pole_pivot").axes
    assert axes.get_ylabel() == "pole_pivot [rad]"
    with pytest.raises(pinred.InputError, match="pole_pivot"):
        plots.branches(found, joint="pile")
    with pytest.raises(pinred.InputError, match="out of range for 1 joints"):
        plots.branches(found, joint=1)
    with pytest.raises(pinred.InputError, match="takes the result of"):
        plots.branches(pinred.load("cartpole"))  # type: ignore[arg-type]
