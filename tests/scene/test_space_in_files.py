"""Scene files and commands with forces that observe the base, act on links, and with events."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import pinred
from pinred.cli.command_line import main
from pinred.forces import Torque, Wrench

TEXT = """
robot = "reaction_wheel_satellite"
load = {lock = ["wheel_x", "wheel_y"]}
start = {x0 = [0.1, 0.0], xi0 = [0.0, 0.1, 0.0, 0.02, 0.0, 0.3]}
run = {duration = 1.5, samples = 11, rtol = 1e-9}
parameters = {gain = 0.4}

[[forces]]
kind = "torque"
function = {wheel_z = "gain*pose[5] + 2*xi[5] - 0.01*J[2] + 0.1*mu[5]"}

[[forces]]
kind = "wrench"
link = "panel"
at = [0.5, 0.0, 0.1]
frame = "world"
function = [0.1, "-0.2*xi[1]", 0.05]

[[forces]]
kind = "wrench"
name = "tug"
frame = "world"
function = [0.01, 0, 0, 0, 0, "0.01*t"]

[[events]]
function = "xi[5] - 0.25*gain/0.4"
name = "slow"
direction = -1

[[events]]
function = "x['panel_hinge'] - 0.09"
name = "open"
terminal = true
"""


def in_python() -> dict[str, Any]:
    """The same scene."""
    gain = pinred.Parameter("gain", 0.4)
    return {
        "x0": [0.1, 0.0], "xi0": [0.0, 0.1, 0.0, 0.02, 0.0, 0.3], "rtol": 1e-9,
        "times": np.linspace(0.0, 1.5, 11), "duration": 1.5,
        "forces": [
            Torque({"wheel_z": lambda s: gain * s.pose[5] + 2 * s.xi[5] - 0.01 * s.J[2]}),
            Torque({"wheel_z": lambda t, x, xdot, mu: 0.1 * mu[5]}, name="mu"),  # noqa: ARG005
            Wrench(
                lambda s: [0.1, -0.2 * s.xi[1], 0.05],
                link="panel", at=[0.5, 0.0, 0.1], frame="world",
            ),
            Wrench(lambda s: ca.vertcat(0.01, 0, 0, 0, 0, 0.01 * s.t), frame="world", name="tug"),
        ],
        "events": [
            pinred.Event(lambda s: s.xi[5] - 0.25 * gain / 0.4, "slow", direction=-1),
            pinred.Event("x['panel_hinge'] - 0.09", "open", terminal=True),
        ],
    }  # fmt: skip


def test_file_with_base_forces_and_events_matches_python(tmp_path: Path) -> None:
    """Torques, wrenches, wrenches on a link, and named events."""
    path = tmp_path / "scene.toml"
    path.write_text(TEXT)
    scene = pinred.load_scene(path)
    read, made = pinred.simulate(scene), pinred.simulate(scene.system, **in_python())
    np.testing.assert_allclose(read.pose, made.pose, atol=1e-9)
    assert list(read.events) == list(made.events) == ["slow", "open"]
    assert read.ended_by == made.ended_by == "open"
    for name in read.events:
        np.testing.assert_allclose(read.events[name].t, made.events[name].t, atol=1e-7)
        assert len(read.events[name]) == 1


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('link = "panel"', 'link = "pannel"', "forces.*link.*no link 'pannel'; did you mean"),
        ("at = [0.5, 0.0, 0.1]", "at = [0.5, 0.0]", "at.*list of 3"),
        ('frame = "world"\nfunction = [0.1', 'frame = "hand"\nfunction = [0.1', "frame.*body"),
        ('function = [0.1, "-0.2*xi[1]", 0.05]', "function = [0.1, 2]", "3 or 6 entries on a link"),
        ("pose[5]", "pose[7]", "pose has no entry 7"),
        ("direction = -1", "direction = 2", "direction.*-1 to 1"),
        ("- 0.09", "- 0.09 +", "events.*function"),
        ('name = "slow"', 'name = "open"', "two events are called 'open'"),
        ("gain = 0.4", "gain = 0.4, J = 1.0", "parameters.*name of letters and digits"),
        ('link = "panel"\n', "", "at.*requires 'link'"),
    ],
)  # fmt: skip
def test_invalid_base_force_error_names_the_key(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    """The message also states the accepted values."""
    path = tmp_path / "scene.toml"
    assert old in TEXT
    path.write_text(TEXT.replace(old, new, 1))
    with pytest.raises(pinred.InputError, match=f"(?s){message}"):
        pinred.load_scene(path)


def test_commands_print_event_times(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`run` prints events by name; `simulate` accepts --events and --until."""
    path = tmp_path / "scene.toml"
    path.write_text(TEXT)
    assert main(["run", str(path), "--explain"]) == 0
    out = capsys.readouterr().out
    assert "observed by forces: attitude and position or velocity of the base" in out
    assert "also integrated: momentum, because wrenches change it (wrench, tug)" in out
    assert "event slow" in out
    assert "event open" in out
    assert "the motion ends there" in out
    beanie = ["simulate", "elroys_beanie", "--xdot0", "1", "--duration", "3", "--rtol", "1e-8"]
    ends = ["--events", "half=x[0] - 0.5", "--events", "x[0] >= 0.6"]
    ends += ["--until", "x['beanie'] - 0.7"]
    assert main([*beanie, *ends, "--out", str(tmp_path / "x.csv")]) == 0
    out = capsys.readouterr().out
    assert "event half: t = 0.5 s" in out
    assert "event until: t = 0.7 s; the motion ends there" in out
