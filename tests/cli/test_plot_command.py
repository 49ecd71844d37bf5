"""`pinred plot`: files of every kind from every source."""

from __future__ import annotations

import os
import re
from pathlib import Path

import commands
import numpy as np
import pytest
from matplotlib.image import imread
from pictures import measured

import pinred
from pinred import plots
from pinred.laboratory.bench import write_record

SCENE = """robot = "elroys_beanie"
[start]
x0 = [0.4]
momentum = [1.5]
[run]
duration = 1.0
[springs]
beanie = [1.0, 0.0]
"""


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    """Return exit code, standard output and standard error of `pinred plot`."""
    return commands.run(capsys, "plot", *arguments)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("suffix", "begins"),
    [
        pytest.param("png", b"\x89PNG", marks=pytest.mark.by_hand),
        pytest.param("pdf", b"%PDF", marks=pytest.mark.by_hand),
        ("svg", b"<?xml"),
    ],
)
def test_plot_writes_identical_files_of_every_suffix(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, suffix: str, begins: bytes
) -> None:
    """The same command writes the same bytes."""
    path = tmp_path / f"cat.{suffix}"
    arguments = ("falling_cat", "--duration", "0.5", "--kind", "shape", "--out", str(path))
    code, out, err = run(capsys, *arguments)
    assert (code, err) == (0, "")
    assert str(path) in out
    first = path.read_bytes()
    assert first.startswith(begins)
    assert run(capsys, *arguments)[0] == 0
    assert path.read_bytes() == first
    assert os.listdir(tmp_path) == [path.name]


@pytest.mark.slow
def test_plot_writes_one_file_per_kind(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """Each option applies to the kinds that accept it."""
    code, _, err = run(
        capsys, "falling_cat", "--duration", "1", "--kind", "shape,curvature,poincare",
        "--joints", "bend,twist", "--component", "w2", "--direction", "0",
        "--out", str(tmp_path / "cat.png"),
    )  # fmt: skip
    assert (code, err) == (0, "")
    kinds = ("curvature", "poincare", "shape")
    assert sorted(os.listdir(tmp_path)) == [f"cat_{kind}.png" for kind in kinds]
    for kind in kinds:
        assert imread(tmp_path / f"cat_{kind}.png").std() > 0.01


# Every run writes figures of the command below, and compares pictures in views/.
@pytest.mark.by_hand
@pytest.mark.slow
def test_plot_matches_the_figure_of_python(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """For a recording and for its scene."""
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE, encoding="utf-8")
    traj = pinred.simulate(pinred.load_scene(scene))
    traj.save(tmp_path / "traj.npz")
    pinred.plot(traj, "energy").savefig(tmp_path / "python.png")
    expected = imread(tmp_path / "python.png")
    out = tmp_path / "out.png"
    assert run(capsys, str(scene), "--kind", "energy", "--out", str(out))[0] == 0
    np.testing.assert_array_equal(imread(out), expected)
    recording = pinred.read_recording(tmp_path / "traj.npz")
    plots.shape(recording).savefig(tmp_path / "python.png")
    assert run(capsys, str(tmp_path / "traj.npz"), "--kind", "shape", "--out", str(out))[0] == 0
    np.testing.assert_array_equal(imread(out), imread(tmp_path / "python.png"))


def test_plot_robot_option_names_robot_of_file(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """A wrong robot is refused."""
    path, out = str(tmp_path / "traj.npz"), str(tmp_path / "a.png")
    pinred.simulate(pinred.load(pinred.load("falling_cat").model), seed=0, duration=0.5).save(path)
    arguments = (path, "--kind", "curvature", "--out", out)
    assert "--robot" in run(capsys, *arguments)[2]
    assert "name the right robot" in run(capsys, *arguments, "--robot", "rigid_body")[2]
    assert os.listdir(tmp_path) == ["traj.npz"]
    assert run(capsys, *arguments, "--robot", "falling_cat")[0] == 0
    assert imread(out).std() > 0.01


def test_plot_prints_the_seed(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """The seed of a random state allows repeating the figure."""
    out = str(tmp_path / "a.png")
    arguments = ("rigid_body", "--seed", "4", "--duration", "1", "--kind", "sphere", "--out", out)
    assert "seed 4" in run(capsys, *arguments)[1]


@pytest.mark.slow
def test_plot_draws_benchmark_record(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """The file of a benchmark gives the figure of its results."""
    path, out = tmp_path / "accuracy.csv", tmp_path / "wp.png"
    write_record(path, "quick", measured())
    assert run(capsys, str(path), "--kind", "work_precision", "--out", str(out))[0] == 0
    plots.work_precision(measured()).savefig(tmp_path / "python.png")
    np.testing.assert_array_equal(imread(out), imread(tmp_path / "python.png"))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ("falling_cat", "--kind", "shapes", "--out", "a.png"),
            "the kinds are base, branches, curvature",
        ),
        (("falling_cat", "--kind", "shape,", "--out", "a.png"), "no plot of kind ''"),
        (("falling_cat", "--kind", "shape", "--out", "a.jpg"), "must be .png or .pdf or .svg"),
        (("falling_cat", "--kind", "shape", "--out", "no/a.png"), "no folder"),
        (
            ("falling_cat", "--kind", "base", "--joints", "bend", "--out", "a.png"),
            "--joints has no effect",
        ),
        (("falling_cat", "--kind", "shape", "--joints", "tail", "--out", "a.png"), "no joint"),
        (("falling_dog", "--kind", "shape", "--out", "a.png"), "did you mean falling_cat"),
        (("cartpole", "--kind", "sphere", "--out", "a.png"), "not for R"),
        (("falling_cat", "--kind", "work_precision", "--out", "a.png"), "pinred bench accuracy"),
        (("no.csv", "--kind", "work_precision", "--out", "a.png"), "cannot read table"),
        (("no.csv", "--kind", "shape", "--out", "a.png"), "only be drawn as work_precision"),
        (("no.npz", "--kind", "shape", "--out", "a.png"), "no such file"),
        (("no.toml", "--kind", "shape", "--out", "a.png"), "no such scene file"),
        (
            ("a.npz", "--kind", "shape", "--seed", "1", "--out", "a.png"),
            "--seed applies to robots only",
        ),
        (("cartpole", "--robot", "ur5", "--kind", "shape", "--out", "a.png"), "--robot applies to"),
        (("falling_cat", "--kind", "shape"), "--out"),
    ],
)
def test_plot_bad_input_is_one_line_and_exit_two(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    words: str,
) -> None:
    """No file is written."""
    monkeypatch.chdir(tmp_path)
    assert words in commands.refused(capsys, "plot", *arguments)
    assert os.listdir(tmp_path) == []


DOCUMENT = (Path(__file__).parents[2] / "docs/plots.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^\$ pinred plot (?!measured)(.*)$", DOCUMENT, re.MULTILINE)


# Other tests draw phases and write all formats.
@pytest.mark.by_hand("cartpole --kind phase --out cartpole.pdf")
@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    [
        command
        if command.startswith(("cartpole", "rigid_body"))
        else pytest.param(command, marks=pytest.mark.by_hand)
        for command in COMMANDS
    ],
)
def test_commands_of_plots_page_run(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    command: str,
) -> None:
    """Every command of docs/plots.md writes one file per kind."""
    if command.startswith("talos"):
        pytest.importorskip("example_robot_data")
    monkeypatch.chdir(tmp_path)
    words = command.split()
    assert run(capsys, *words)[0] == 0
    kinds = words[words.index("--kind") + 1].split(",")
    assert len(os.listdir(tmp_path)) == len(kinds)


def test_plots_page_lists_kinds_and_options() -> None:
    """The table of docs/plots.md is complete."""
    rows = re.findall(r"^\| `(\w+)` \|.*\| (.*) ?\|$", DOCUMENT, re.MULTILINE)
    assert {kind: tuple(re.findall(r"`(\w+)`", options)) for kind, options in rows} == {
        kind: plots.options_of(kind) for kind in plots.KINDS
    }


@pytest.mark.by_hand
def test_example_of_plots_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It writes one file of each format."""
    monkeypatch.chdir(tmp_path)
    (code,) = re.findall(r"```python\n(.*?)```", DOCUMENT, re.DOTALL)
    exec(compile(code, "plots.md", "exec"), {})
    assert sorted(os.listdir(tmp_path)) == ["curvature.svg", "phase.pdf", "shape.png"]


def test_failed_plot_keeps_the_old_file(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No partial file remains."""
    path = tmp_path / "a.png"
    path.write_text("old")

    def broken(_: object, file: object, **__: object) -> None:
        file.write(b"half")  # type: ignore[attr-defined]
        raise OSError("disk full")

    from pinred.views.plots.style import StyledFigure

    monkeypatch.setattr(StyledFigure, "savefig", broken)
    arguments = ("cartpole", "--duration", "0.1", "--kind", "shape", "--out", str(path))
    code, _, err = run(capsys, *arguments)
    assert code == 2
    assert "disk full" in err
    assert os.listdir(tmp_path) == ["a.png"]
    assert path.read_text() == "old"
