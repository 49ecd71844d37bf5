"""`pinred gait` and `pinred reorient`: output, files and errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pinred
from pinred.cli.command_line import main


def test_gait_writes_the_printed_loop(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The certificate is printed, and the file has the optimal loop."""
    for suffix in ("npz", "csv"):
        path = tmp_path / f"loop.{suffix}"
        words = "gait three_rods --limits 1.5 --harmonics 1 --starts 1 --out"
        assert main([*words.split(), str(path)]) == 0
        said = capsys.readouterr().out
        for part in ("rotation / length", "winding number", "KKT residual", "margins "):
            assert part in said
        A = pinred.Connection.mechanical(pinred.load("three_rods"))
        best = pinred.optimise_gait(A, limits=1.5, harmonics=1, starts=1)
        assert f"{best.value:.10g}" in said
        read = pinred.phase(A, pinred.Gait.read(path))
        assert read.pose[2] == pytest.approx(best.phase.pose[2], rel=1e-6)


def test_gait_prints_its_distance_from_the_optimum(capsys: pytest.CaptureFixture[str]) -> None:
    """A polygon has no extremal, and says so."""
    words = "gait three_rods --cost none --vertices 6 --limits 1 --starts 1"
    assert main([*words.split(), "--distance"]) == 0
    assert "distance from optimum: not known" in capsys.readouterr().out
    assert main(words.split()) == 0
    assert "distance" not in capsys.readouterr().out


def test_reorient_writes_the_planned_motion(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The plan is printed, and the file has its motion."""
    path = tmp_path / "turn.npz"
    words = "reorient three_rods --target -0.3 --limits alpha1=2.5,alpha2=2 --x0 0.4,0.5 --out"
    assert main([*words.split(), str(path)]) == 0
    assert "turned [°]              -17.188734" in capsys.readouterr().out
    with np.load(path) as file:
        assert file["pose"][-1, 2] == pytest.approx(-0.3, abs=1e-8)


def test_arguments_replace_objectives_of_gait_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A figure shows the optimal loop."""
    path, figure = tmp_path / "rods.toml", tmp_path / "loop.png"
    path.write_text(
        "robot = 'three_rods'\nmomentum = [0.0, 0.0, 0.01]\n"
        "[optimise]\nlimits = 1.5\nharmonics = 1\nstarts = 1\n"
        "[reorient]\ntarget = 0.3\nlimits = 2.5\nx0 = [0.4, 0.5]\n"
    )
    assert main(["gait", str(path), "--limits", "1.2", "--out", str(figure)]) == 0
    A = pinred.Connection.mechanical(pinred.load("three_rods"))
    best = pinred.optimise_gait(A, limits=1.2, harmonics=1, starts=1)
    assert f"{best.value:.10g}" in capsys.readouterr().out
    assert figure.read_bytes()[:4] == b"\x89PNG"
    figure.unlink()
    assert main(["reorient", str(path), "--out", str(figure)]) == 0
    said = capsys.readouterr().out
    assert "turned [°]              17.188734" in said
    assert "tumble left" in said
    assert figure.stat().st_size > 10_000
    assert main(["phase", str(path)]) == 2
    assert "no gait of 'three_rods' is given" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("gait three_rods --objective spin", "objective must be one of"),
        ("gait three_rods --limits much", "--limits takes numbers"),
        ("gait three_rods --out loop.gif", "loop.gif"),
        ("reorient three_rods", "pass --target"),
        ("reorient three_rods --target 0.3 --momentum 1,2", "momentum"),
        (
            "reorient examples/gaits/satellite_turns.toml --group SE3",
            "--group applies to robots only",
        ),
        ("reorient three_rods --target up", "--target takes numbers"),
        ("reorient elroys_beanie --target 1", "needs two joints"),
    ],
)
def test_gait_bad_input_is_one_line(
    words: str, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The exit code is 2."""
    assert main(words.split()) == 2
    assert says in capsys.readouterr().err
