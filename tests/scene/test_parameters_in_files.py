"""Robot parameters in files and on the command line, under their names in Python."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred import InputError
from pinred.cli.command_line import main

SCENE = """robot = "falling_cat"
start = { x0 = [0.3, 0.4], xi0 = [0.1, 0, 0, 0.2, -0.1, 0.3] }
run = { duration = 0.3, samples = 3 }
load = { lock = { sway = 0.3 } }
[parameters]
gain = 2.0
PLACE
"front.payload.mass" = 0.5
front.com = [0.1, 0, 0.2]
sway.lock = 0.5
gravity = [0, 0, -3.7]
[[forces]]
kind = "torque"
function = { bend = "-gain*x['bend']" }
"""
VALUES: dict[str, Any] = {
    "gain": 2.0,
    "front.payload.mass": 0.5,
    "front.com": [0.1, 0.0, 0.2],
    "sway.lock": 0.5,
    "gravity": [0.0, 0.0, -3.7],
}


def scene_file(folder: Path, line: str = "", **changes: str) -> Path:
    """The file with another line among its parameters, and words changed."""
    path, text = folder / "scene.toml", SCENE.replace("PLACE", line)
    for old, new in changes.items():
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")
    return path


def changed_cat() -> pinred.System:
    """The robot of the file, as Pinocchio changes it: loaded anew, with a body added."""
    model = pinred.load("falling_cat", lock={"sway": 0.5}, gravity=VALUES["gravity"]).model.copy()
    front = int(model.frames[model.getFrameId("front")].parentJoint)
    body = model.inertias[front]
    moved = pin.Inertia(body.mass, np.array(VALUES["front.com"]), body.inertia)
    model.inertias[front] = moved + pin.Inertia.FromSphere(0.5, 0.0)
    return pinred.load(model)


@pytest.mark.slow
def test_file_parameters_match_python_and_pinocchio(tmp_path: Path) -> None:
    """Names in quotes and tables mean the same; Pinocchio with the same changes agrees."""
    scene = pinred.load_scene(scene_file(tmp_path))
    assert scene.parameters.keys() == VALUES.keys()
    for name, value in VALUES.items():
        np.testing.assert_array_equal(scene.parameters[name], value)
    traj = pinred.simulate(scene)
    assert pinred.compare(traj).passed
    judge = changed_cat()
    path = tmp_path / "traj.npz"
    traj.save(path)
    recorded = pinred.read_recording(path).system
    for model in (traj.system.model, recorded.model):
        for ours, theirs in zip(model.inertias, judge.model.inertias, strict=True):
            np.testing.assert_allclose(ours.matrix(), theirs.matrix(), rtol=0, atol=1e-13)
        for here, there in zip(model.jointPlacements, judge.model.jointPlacements, strict=True):
            np.testing.assert_allclose(here.homogeneous, there.homogeneous, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(recorded.gravity, VALUES["gravity"])


@pytest.mark.parametrize(
    ("line", "match"),
    [
        ("front.mss = 1", r"line 7: parameters.front.mss: there is no 'front.mss'; did you mean"),
        ("front.mass = -1", r"parameters.front.mass: 'front.mass' must be above zero"),
        ("front.mass = nan", r"parameters.front.mass: must be finite"),
        ("front.mass = [1, 2]", r"parameters.front.mass: .* must have shape \(1,\), got \(2,\)"),
        ("bend.placement = [1, 2]", r"parameters.bend.placement: .* must have shape \(6,\)"),
        ("front.mass = 'heavy'", r"parameters.front.mass: must be a number"),
        ("'front.com' = [0, 0, 0]", r"parameters.front.com: 'front.com' is given twice"),
        ("bak.mass = 1", r"parameters.bak.mass: .* no link or joint 'bak'; did you mean 'back'"),
        ("back.inertia = [1, 0, 0, 1, 0, 3]", r"parameters.back.inertia: .* is not physical"),
        ("hand = 3", r"line 7: parameters.hand: there is no 'hand'; .* here are gain"),
        ("x = 3", r"parameters.x: must be a name"),
        ("k = [1, 2]", r"parameters.k: a number that formulas use must be one"),
        (
            "back.log_cholesky = [0, 0, 0, 0, 0, 0, 0, 0, 0, 0]",
            r"sets all parameters of a body|whose inertia",
        ),
        ("gravity.strength = 2", r"not TOML"),
    ],
)
def test_invalid_parameter_error_names_file_line_and_key(
    tmp_path: Path, line: str, match: str
) -> None:
    """Unknown names and unphysical values are refused."""
    if "log_cholesky" in line:
        line += "\nback.mass = 1"
    with pytest.raises(pinred.PinredError, match=match):
        pinred.load_scene(scene_file(tmp_path, line))


def test_gait_file_accepts_robot_parameters_only(tmp_path: Path) -> None:
    """A gait file has no formulas."""
    path = tmp_path / "gait.toml"
    text = 'robot = "falling_cat"\n[parameters]\nfront.mass = 4.0\n'
    path.write_text(text, encoding="utf-8")
    file = pinred.load_gait(path)
    assert file.system.parameters == {"front.mass": 4.0}
    model = file.connection.system.model  # type: ignore[union-attr]
    assert 4.0 in [each.mass for each in model.inertias]
    path.write_text(text + "gain = 2.0\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"line 4: parameters.gain: there is no 'gain'; .*LINK"):
        pinred.load_gait(path)


def test_parameter_option_replaces_the_value_in_the_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """--parameters also works for a robot."""
    path, out = scene_file(tmp_path), tmp_path / "traj.npz"
    words = ["--parameters", "front.payload.mass=0.7", "--parameters", "gain=3"]
    assert main(["run", str(path), "--out", str(out), *words]) == 0
    assert pinred.read_recording(out).system.parameters["front.payload.mass"] == 0.7
    scene = pinred.load_scene(path)
    traj = pinred.simulate(scene, parameters={"front.payload.mass": 0.7, "gain": 3.0})
    np.testing.assert_array_equal(pinred.read_recording(out).x, traj.x)
    assert traj.scene.parameters["sway.lock"] == 0.5  # what is not given stays
    robot = ["falling_cat", "--seed", "1", "--duration", "0.1", "--samples", "3", "--out", str(out)]
    place = "bend.placement=0.1,0,0,0.2,-0.4,0.7"
    assert main(["simulate", *robot, "--parameters", "front.mass=2", "--parameters", place]) == 0
    traj = pinred.simulate(
        pinred.load("falling_cat"), seed=1, times=[0.0, 0.05, 0.1],
        parameters={"front.mass": 2.0, "bend.placement": [0.1, 0.0, 0.0, 0.2, -0.4, 0.7]},
    )  # fmt: skip
    recording = pinred.read_recording(out)
    np.testing.assert_array_equal(recording.x, traj.x)
    turned = np.ravel(recording.system.parameters["bend.placement"])
    np.testing.assert_array_equal(turned, [0.1, 0.0, 0.0, 0.2, -0.4, 0.7])
    capsys.readouterr()
    for entry, match in (
        ("front.mss=2", "there is no 'front.mss'; did you mean 'front.mass'"),
        ("front.mass", "--parameters takes NAME=NUMBER"),
        ("front.mass=heavy", "--parameters takes NAME=NUMBER"),
        ("front.mass=nan", "must be finite"),
        ("front.mass=-1", "must be above zero"),
    ):
        assert main(["inspect", "falling_cat", "--parameters", entry]) != 0
        assert match in capsys.readouterr().err
    twice = ["--parameters", "front.mass=1", "--parameters", "front.mass=2"]
    assert main(["inspect", "falling_cat", *twice]) != 0
    assert "'front.mass' twice" in capsys.readouterr().err
