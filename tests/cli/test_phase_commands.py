"""`pinred phase` and `pinred field`: numbers, files, and one-line errors."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import pinred
from pinred.cli.command_line import main

ROOT = Path(__file__).parents[2]
EXAMPLE = str(ROOT / "examples/gaits/purcell_circle.toml")


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    """Run a command; return its code, output and errors."""
    code = main(words)
    out, err = capsys.readouterr()
    return code, out, err


def number(text: str, pattern: str) -> float:
    """The number in the one place that matches."""
    (found,) = re.findall(pattern.replace("N", r"(-?[\d.]+(?:e-?\d+)?)"), text)
    return float(found)


def test_phase_of_gait_file_prints_published_displacement(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Also for three cycles; the poses are written to a file."""
    out = tmp_path / "way.npz"
    code, text, _ = run(capsys, "phase", EXAMPLE, "--cycles", "3", "--out", str(out))
    assert code == 0
    assert number(text, "slide of N m") == pytest.approx(0.0512808243, abs=5e-11)
    x, y = (number(text, rf"after 3 cycles .*{name} N") for name in "xy")
    assert np.hypot(x, y) == pytest.approx(3 * 0.0512808243, abs=2e-10)
    with np.load(out) as file:
        assert np.hypot(*file["end"][:2]) == pytest.approx(0.0512808243, abs=5e-11)
        assert file["pose"].shape == (len(file["t"]), 3)


def test_phase_of_robot_with_momentum_matches_python(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Also as csv and figure."""
    table, picture = tmp_path / "way.csv", tmp_path / "cycles.png"
    words = ("phase", "falling_cat", "--circle", "bend,sway,0.8", "--momentum", "0,0,0,0.1,0,0")
    code, text, _ = run(capsys, *words, "--out", str(table))
    assert code == 0
    cat = pinred.load("falling_cat")
    gait = pinred.Gait.fourier(
        np.zeros(3), 0.8 * np.eye(3)[[cat.shape_names.index("bend")]],
        0.8 * np.eye(3)[[cat.shape_names.index("sway")]],
    )  # fmt: skip
    p = pinred.phase(pinred.Connection.mechanical(cat), gait, [0, 0, 0, 0.1, 0, 0])
    assert number(text, "turn +N rad") == pytest.approx(p.screw.angle, abs=1e-11)
    assert "geometric" in text
    assert "dynamic" in text
    rows = np.loadtxt(table, delimiter=",", skiprows=1)
    np.testing.assert_allclose(rows[-1, 1:], p.pose, atol=1e-12)
    assert run(capsys, *words, "--out", str(picture))[0] == 0
    assert picture.stat().st_size > 1000


def test_phase_of_recorded_csv(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """The csv file has the joints over one cycle."""
    t = np.linspace(0.0, 2.0, 201)
    x = np.stack([np.cos(np.pi * t), np.sin(np.pi * t)], axis=1)
    path = tmp_path / "loop.csv"
    table = np.column_stack([t, x])
    np.savetxt(path, table, fmt="%.17g", delimiter=",", header="t,alpha1,alpha2", comments="")
    code, text, _ = run(capsys, "phase", "three_rods", "--gait", str(path))
    assert code == 0
    assert "one cycle of 2 s" in text
    assert abs(number(text, "θ N")) < 1e-9


def test_field_writes_connection_and_curvature(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """A and B on a grid equal those of the reduction."""
    out = tmp_path / "field.npz"
    words = ("field", "falling_cat", "--joints", "sway,twist", "--limits", "-1,0.5")
    code, _, _ = run(capsys, *words, "--at", "0.2,0.0,0.0", "--samples", "5", "--out", str(out))
    assert code == 0
    red = pinred.Reduction(pinred.load("falling_cat"))
    with np.load(out) as file:
        x = file["x"][1, 3]
        assert list(file["joints"]) == list(red.system.shape_names)
        assert x[list(file["joints"]).index("sway")] == pytest.approx(-1.0 + 1.5 / 4)
        np.testing.assert_allclose(file["curvature"][1, 3], red.curvature(x), atol=1e-13)
        np.testing.assert_allclose(file["local"][1, 3], red.local_connection(x), atol=1e-13)


@pytest.mark.parametrize("part", ["curvature", "connection"])
@pytest.mark.sampled
def test_field_draws_a_figure_with_the_gait(
    part: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """A gait file adds its gait to the figure; a robot has none."""
    out = tmp_path / "field.svg"
    words = ("field", EXAMPLE, "--component", "v1", "--part", part, "--out", str(out))
    assert run(capsys, *words)[0] == 0
    assert "signed area" in out.read_text("utf-8") or out.stat().st_size > 10000
    assert run(capsys, "field", "three_rods", "--limits", "-1,1", "--out", str(out))[0] == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("phase", "three_rods"), "a robot needs a gait"),
        (("phase", "three_rods", "--circle", "alpha1,1.0"), "J1,J2,RADIUS"),
        (("phase", "three_rods", "--circle", "alpha1,nope,1.0"), "no shape joint 'nope'"),
        (("phase", EXAMPLE, "--circle", "alpha1,alpha2,1.0"), "applies to robots only"),
        (("phase", EXAMPLE, "--momentum", "1,0,0"), "momentum"),
        (("phase", EXAMPLE, "--out", "way.txt"), "the suffix must be"),
        (("field", "elroys_beanie", "--out", "f.npz"), "at least 2 joints"),
        (("field", "three_rods", "--limits", "1,-1", "--out", "f.npz"), "LOW,HIGH"),
        (("field", "three_rods", "--part", "nope", "--out", "f.png"), "part must be one of"),
    ],
)
def test_phase_bad_input_is_one_line(
    words: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str],
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """In one line, without a file left behind."""
    monkeypatch.chdir(tmp_path)
    code, out, err = run(capsys, *words)
    assert code == 2
    assert out == ""
    assert message in err
    assert err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("kind", "command"), [("field", "pinred field"), ("cycles", "pinred phase")]
)
def test_plot_refers_to_field_and_phase_commands(
    kind: str, command: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Figures that are not of a motion have separate commands."""
    words = ("plot", "three_rods", "--kind", kind, "--out", str(tmp_path / "out.png"))
    code, _, err = run(capsys, *words)
    assert code == 2
    assert f"draw it with `{command}`" in err


def test_commands_take_loops_of_balls_about_a_centre(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """The axes of a ball have labels; `phase` and `field` take the same centre as Python."""
    centre, out = ("--centre", "spine=0,0.2,0.1"), tmp_path / "field.npz"
    words = ("falling_cat_ball", "--circle", "spine.y,spine.z,1.2", *centre)
    code, text, _ = run(capsys, "phase", *words)
    assert code == 0
    cat = pinred.Connection.mechanical(pinred.load("falling_cat_ball"))
    about = cat.in_chart({"spine": [0.0, 0.2, 0.1]})
    circle = pinred.Gait.fourier([0.0] * 3, [[0.0, 1.2, 0.0]], [[0.0, 0.0, 1.2]])
    p = pinred.phase(about, circle)
    assert number(text, "turn +N rad") == pytest.approx(p.screw.angle, rel=1e-11)
    code, _, _ = run(
        capsys, "field", "falling_cat_ball", *centre, "--samples", "3", "--out", str(out)
    )
    assert code == 0
    with np.load(out) as file:
        np.testing.assert_array_equal(file["curvature"], about.grid(file["x"]).curvature)
    picture = tmp_path / "field.png"
    code, _, _ = run(capsys, "field", *words, "--out", str(picture))
    assert code == 0
    assert picture.stat().st_size > 10_000
    code, _, err = run(capsys, "phase", "falling_cat_ball", "--circle", "spine.y,spine.w,1.2")
    assert code != 0
    assert "the joints are spine.x, spine.y, spine.z" in err


def test_commands_state_loops_and_independent_joints(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Loops of a URDF are closed; gait files, phase, gait and field use the stated joints."""
    urdf = str(ROOT / "robots/parallel_biped.urdf")
    feet = "left_front_foot=left_rear_foot:3d,right_front_foot=right_rear_foot:3d"
    hips = ["left_front_hip", "left_rear_hip", "right_front_hip", "right_rear_hip"]
    loaded = (urdf, "--group", "SE3", "--loops", feet, "--independent", ",".join(hips))
    code, text, err = run(capsys, "phase", *loaded, "--circle", f"{hips[0]},{hips[1]},0.1")
    assert code == 0, err
    biped = pinred.load(urdf, group="SE3", loops=feet)
    connection = pinred.Connection.mechanical(biped, independent=hips)
    assert biped.closure is not None
    rest = biped.closure.x[[biped.shape_names.index(name) for name in hips]]
    circle = pinred.Gait.fourier(rest, 0.1 * np.eye(4)[:1], 0.1 * np.eye(4)[1:2])
    p = pinred.phase(connection, circle)
    assert number(text, "turn +N rad") == pytest.approx(p.screw.angle, abs=1e-11)
    assert abs(p.screw.angle) > 1e-4
    grid = tmp_path / "grid.npz"
    words = ("--joints", f"{hips[2]},{hips[0]}", "--limits", "-1.2,-1", "--samples", "3")
    code, _, err = run(capsys, "field", *loaded, *words, "--out", str(grid))
    assert code == 0, err
    with np.load(grid) as file:
        assert file["joints"].tolist() == hips
        middle = file["x"][1, 1]
        np.testing.assert_allclose(middle[[0, 2]], -1.1)
        np.testing.assert_allclose(middle[[1, 3]], rest[[1, 3]])
        np.testing.assert_allclose(file["local"][1, 1], connection.local(middle), atol=1e-13)
    path = tmp_path / "gait.toml"
    path.write_text(
        f"robot = {urdf!r}\nindependent = {hips}\n[load]\ngroup = 'SE3'\nloops = {feet!r}\n"
        f"[gait]\nkind = 'fourier'\nmean = {rest.tolist()}\n"
        "cos = [[0.1, 0, 0, 0]]\nsin = [[0, 0.1, 0, 0]]\n",
        "utf-8",
    )
    code, text, err = run(capsys, "phase", str(path))
    assert code == 0, err
    assert number(text, "turn +N rad") == pytest.approx(p.screw.angle, abs=1e-11)
    code, _, err = run(capsys, "phase", str(path), "--independent", "left_front_hip")
    assert (code, "--independent applies to robots only" in err) == (2, True)
    code, _, err = run(capsys, "gait", urdf, "--group", "SE3", "--loops", feet,
                       "--independent", "left_front_hip")  # fmt: skip
    assert (code, "expected 4 joints, each once, got left_front_hip" in err) == (2, True)
    code, _, err = run(capsys, "phase", "three_rods", "--independent", "alpha1",
                       "--circle", "alpha1,alpha2,1")  # fmt: skip
    assert (code, "independent: expected none, because the robot has no loops" in err) == (2, True)
