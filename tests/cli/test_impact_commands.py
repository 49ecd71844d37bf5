"""The commands capture, release and land, with scene files and recordings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pinred
from pinred.cli.command_line import main

ROCK = """
robot = "{name}.urdf"
[load]
gravity = [0, 0, 0]
[start]
pose0 = [{x}, 0, 0, 0, 0, 0, 1]
xi0 = [{v}, 0.1, 0, 0.2, 0, 0]
[run]
duration = 1.0
"""


@pytest.fixture
def scenes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write two bodies that meet at the origin at 1 s, and a robot that falls."""
    for name, x, v in (("a", -0.5, 0.5), ("b", 0.26, -0.25)):
        rock = pinred.Model(name).body(name, mass=2.0, inertia=1.0)
        rock.save(tmp_path / f"{name}.urdf")
        (tmp_path / f"{name}.toml").write_text(ROCK.format(name=name, x=x, v=v), "utf-8")
    hopper = pinred.Model("hopper").body("trunk", mass=3.0, inertia=[0.1, 0.2, 0.3])
    hopper = hopper.fixed("foot", parent="trunk", at=[0, 0.05, -0.4])
    hopper.save(tmp_path / "hopper.urdf")
    (tmp_path / "hopper.toml").write_text(
        'robot = "hopper.urdf"\n[start]\npose0 = [0, 0, 1, 0, 0, 0, 1]\n'
        "xi0 = [0.2, 0, 0, 0.1, 0.5, 0]\n[run]\nduration = 2.0\n"
        "[[events]]\nfunction = \"height['foot']\"\nterminal = true\ndirection = -1\n",
        "utf-8",
    )
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_capture_command_writes_the_chain(scenes: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Both scenes, the capture and the motion after it are one recording, which passes."""
    words = ["capture", "a.toml", "b.toml", "--at", "a", "--onto", "b", "--tolerance", "0.2"]
    assert main([*words, "--duration", "0.5", "--out", "both.npz", "--compare"]) == 0
    text = capsys.readouterr().out
    assert text.startswith("a captures b: b fixed to a\n")
    assert "verdict of the chain: PASSED" in text
    recording = pinred.read_recording(scenes / "both.npz")
    assert recording.t[-1] == 1.5
    assert recording.system.mass == pytest.approx(4.0)
    J = recording.spatial_momentum
    np.testing.assert_allclose(J, np.tile(J[0], (len(J), 1)), atol=1e-9)
    assert main(["plot", "both.npz", "--kind", "momentum", "--out", "momentum.png"]) == 0
    assert main(["play", "both.npz", "--out", "both.html"]) == 0
    assert main(["release", "both.npz", "--link", "b", "--duration", "1"]) == 2
    assert "need scene files" in capsys.readouterr().err


def test_land_command_prints_the_impulse(scenes: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The flight ends at the ground; the stance follows; a flat foot has none."""
    assert main(["land", "hopper.toml", "--frame", "foot"]) == 0
    assert "impulse on foot [N·s]" in capsys.readouterr().out
    words = ["land", "hopper.toml", "--frame", "foot", "--duration", "0.1", "--out", "all.npz"]
    assert main([*words, "--compare"]) == 0
    assert "verdict of the chain: PASSED" in capsys.readouterr().out
    assert (scenes / "all.npz").exists()
    assert (
        main(["land", "hopper.toml", "--frame", "foot", "--contact", "flat", "--duration", "1"])
        == 2
    )
    assert "the group is trivial" in capsys.readouterr().err
    words = ["land", "hopper.toml", "--frame", "foot", "--contact", "flat", "--out", "flat.npz"]
    assert main([*words, "--compare"]) == 0
    assert "verdict of the chain: PASSED" in capsys.readouterr().out
    recording = pinred.read_recording(scenes / "flat.npz")
    assert np.abs(recording.v[-1]).max() <= 1e-14  # a rigid body on a flat foot stands still
    assert np.abs(recording.v[-2]).max() > 1.0


def test_release_command_prints_both_parts(
    scenes: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A recording of a captured robot opens again."""
    del scenes
    words = ["capture", "a.toml", "b.toml", "--at", "a", "--onto", "b", "--tolerance", "0.2"]
    assert main([*words, "--duration", "0.5", "--out", "both.npz"]) == 0
    assert main(["release", "both.npz", "--link", "b"]) == 0
    assert "2 kg, SE3 x 0 joints" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["capture", "a.toml", "b.toml", "--at", "a", "--onto", "b"], "do not coincide"),
        (["capture", "a.urdf", "b.toml", "--at", "a", "--onto", "b"], "expected a scene file"),
        (["capture", "a.toml", "b.toml", "--at", "a"], "--onto"),
        (["land", "hopper.toml", "--frame", "toe"], "no link 'toe'"),
        (["land", "hopper.toml", "--frame", "foot", "--method", "RKMK4(0.1)"], "pass --duration"),
        (["land", "hopper.toml", "--frame", "foot", "--duration", "1", "--out", "f.txt"], "f.txt"),
        (["release", "a.toml", "--link", "a"], "is the root"),
    ],
)
def test_impossible_impact_is_refused_in_one_line(
    scenes: Path, words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The message names the option or the remedy; the exit code is 2."""
    del scenes
    try:
        code = main(words)
    except SystemExit as stop:
        code = int(str(stop.code))
    assert code == 2
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert error.startswith("pinred: error: ")
    assert message in error
