"""The table [sweep] of scene files and `pinred sweep`, with the names of `pinred.sweep`."""

from __future__ import annotations

import inspect
from pathlib import Path

import numpy as np
import pytest

import pinred
from pinred.cli.command_line import main
from pinred.scene.scene_options import SWEEP_OPTIONS

TEXT = """
robot = "falling_cat"
[start]
xdot0 = [0.5, -0.3, 0.2]
momentum = 0
[run]
duration = 0.5
rtol = 1e-6
atol = 1e-8
[[forces]]
kind = "damper"
joint = "bend"
coefficient = 0.1
[sweep]
points = 20
seed = 3
outputs = { pose = "pose", bend = "x.bend" }
store = "s.zarr"
[sweep.vary]
front.mass = "Normal(1, 0.5)"
"x0.bend" = [0.1, 0.2]
"forces[0].coefficient" = "Uniform(0, 1)"
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A scene file with a table [sweep]."""
    path = tmp_path / "scene.toml"
    path.write_text(TEXT, encoding="utf-8")
    return path


def test_one_description_has_the_names_of_python() -> None:
    """The keys of [sweep] are parameters of `sweep`; the others are of one process."""
    parameters = [*inspect.signature(pinred.sweep).parameters]
    assert parameters[0] == "scene"
    assert [*SWEEP_OPTIONS, "threads", "device", "progress"] == parameters[1:]


def test_command_gives_the_numbers_of_python(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The command runs the file; Python with the same arguments gives the same bits."""
    assert main(["sweep", str(file)]) == 0
    output = capsys.readouterr()
    assert "falling_cat: 20 points, 0 failed, 1 rejected" in output.out
    assert "bend [rad]: " in output.out
    assert "1 rejected of 20 points, listed in `failures`" in output.err
    written = pinred.open_sweep(file.with_name("s.zarr"))
    vary = {
        "front.mass": pinred.Normal(1, 0.5), "x0.bend": [0.1, 0.2],
        "forces[0].coefficient": pinred.Uniform(0, 1),
    }  # fmt: skip
    with pytest.warns(pinred.RejectedWarning):
        result = pinred.sweep(
            pinred.load_scene(file), vary, points=20, seed=3,
            outputs={"pose": "pose", "bend": "x.bend"},
        )  # fmt: skip
    for name in result.variables:
        np.testing.assert_array_equal(result[name], written[name])


def test_options_replace_keys(file: Path) -> None:
    """Options of the command line take precedence over the file."""
    store = file.with_name("t.zarr")
    words = ["--points", "4", "--vary", "front.mass=Uniform(1, 2)", "--outputs", "e=energy"]
    assert main(["sweep", str(file), *words, "--store", str(store), "--block", "2"]) == 0
    result = pinred.open_sweep(store)
    assert set(result.data_vars) == {"e", "status"}
    assert len(result["e"]) == 4
    assert float(result["front.mass"].min()) >= 1.0


@pytest.mark.parametrize(
    ("old", "new", "words", "message"),
    [
        ('"Normal(1, 0.5)"', '"Norml(1)"', [], "line 14: sweep: vary: 'front.mass': unknown"),
        ("points", "pionts", [], "unknown key \"pionts\"; did you mean 'points'"),
        ("front.mass", "frnt.mass", [], "sweep: vary: there is no 'frnt.mass'"),
        ('store = "s.zarr"', "", [], "store: expected a table [sweep] with the key 'store'"),
        ("[sweep.vary]", "[sweep.vary.x0]\nbend = [1]\n[sweep.vary]", [], "stated twice"),
        ("", "", ["--vary", "front.mass"], "--vary takes NAME=LAW"),
    ],
)
def test_errors_name_file_and_key(
    old: str, new: str, words: list[str], message: str, file: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """The message names the line and the key of the file, or the option."""
    file.write_text(TEXT.replace(old, new), encoding="utf-8")
    assert main(["sweep", str(file), *words]) == 2
    assert message in capsys.readouterr().err
