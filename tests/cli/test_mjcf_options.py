"""MJCF on the command line, in scene files and in motion files."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import run

import pinred
from pinred import InputError

TEXT = """<mujoco><worldbody>
<body name="robot"><freejoint name="float"/><geom size=".3"/>
<body name="arm" pos=".5 0 0"><joint name="elbow" damping="1"/><geom size=".2" pos=".3 0 0"/></body>
</body>
<body name="ball" pos="5 0 0"><freejoint name="drift"/><geom size=".1"/></body></worldbody>
<keyframe><key name="home" qpos="1 2 3 1 0 0 0 .4 5 0 0 1 0 0 0" qvel="0 0 1 0 0 0 .7 0 0 0 0 0 0"/>
</keyframe></mujoco>"""
ROBOT = ("--root", "robot")

pytestmark = pytest.mark.filterwarnings("ignore::pinred.common.errors.LeftOutWarning")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A file with a robot and a ball."""
    path = tmp_path / "robot.xml"
    path.write_text(TEXT, encoding="utf-8")
    return path


def test_inspect_of_mjcf_lists_keyframes_and_left_out_parts(
    path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The output names both."""
    code, out, _ = run(capsys, "inspect", str(path), *ROBOT)
    assert code == 0
    assert "left out    contact: geom 0, geom 1\n" in out
    said = "the file has 1 damper; a run leaves it out (passive=True uses it)"
    assert f"            {said}\n" in out
    assert "            other bodies: ball\n" in out
    assert "keyframes   home\n" in out


@pytest.mark.filterwarnings("default::pinred.common.errors.LeftOutWarning")
def test_mjcf_warning_is_one_line(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The warning is written to standard error."""
    code, _, err = run(capsys, "inspect", str(path), *ROBOT)
    assert code == 0
    start = "pinred: warning: robot: in the file, but not simulated: contact (2), "
    assert err.startswith(start)
    assert err.count("\n") == 1


def test_mjcf_without_root_lists_the_bodies(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The message lists the bodies to choose from."""
    code, _, err = run(capsys, "inspect", str(path))
    assert code == 2
    assert "robot, ball" in err


def test_keyframe_starts_the_motion_and_file_names_the_root(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The motion file identifies the robot among the bodies of the MJCF file."""
    out = tmp_path / "motion.npz"
    arguments = ("--keyframe", "home", "--duration", "0.1", "--out", str(out))
    code, text, _ = run(capsys, "simulate", str(path), *ROBOT, *arguments)
    assert code == 0
    assert "random" not in text
    recording = pinred.read_recording(out)
    assert recording.x[0] == pytest.approx([0.4])
    assert recording.xdot[0] == pytest.approx([0.7])
    assert recording.pose[0] == pytest.approx([1, 2, 3, 0, 0, 0, 1])
    assert recording.system.shape_names == ("elbow",)
    assert recording.system.root_name == "float"
    picture = tmp_path / "phase.png"
    code, _, _ = run(
        capsys,
        "plot",
        str(path),
        *ROBOT,
        "--kind",
        "phase",
        "--duration",
        "0.1",
        "--out",
        str(picture),
    )
    assert code == 0
    assert picture.is_file()


def test_scene_file_accepts_root_and_keyframe(path: Path) -> None:
    """pose0 moves the base of the keyframe."""
    scene = path.with_name("scene.toml")
    text = 'robot = "robot.xml"\nload = {root = "robot"}\n[start]\nkeyframe = "home"\n'
    scene.write_text(text)
    start = pinred.load_scene(scene).start
    assert start.x == pytest.approx([0.4])
    assert start.pose[:3] == pytest.approx([1, 2, 3])
    assert start.xi == pytest.approx([0, 0, 1, 0, 0, 0])
    scene.write_text(text + "pose0 = [0, 0, 0, 0, 0, 0, 1]\n")
    start = pinred.load_scene(scene).start
    assert start.pose.tolist() == [0, 0, 0, 0, 0, 0, 1]
    assert start.x == pytest.approx([0.4])
    scene.write_text(text.replace("home", "away"))
    with pytest.raises(InputError, match=r"start\.keyframe.*'away'; the keyframes are home"):
        pinred.load_scene(scene)
    for key in ("x0 = [0]", "seed = 1", "q0 = [0, 0, 0, 0, 0, 0, 1, 0]"):
        scene.write_text(f"{text}{key}\n")
        with pytest.raises(InputError, match="keyframe"):
            pinred.load_scene(scene)


def test_keyframe_excludes_other_state_options(path: Path) -> None:
    """Only pose0 and velocities may be combined with it."""
    system = pinred.load(path, root="robot")
    for options in ({"x0": [0.0]}, {"q0": np.zeros(8)}, {"seed": 1}):
        with pytest.raises(InputError, match=f"keyframe.*{next(iter(options))}"):
            pinred.Scene(system=system, keyframe="home", **options)
    with pytest.raises(InputError, match="the keyframes are none"):
        pinred.Scene(system=pinred.load("falling_cat"), keyframe="home")


KEPT = {"xdot0": [0.7], "xi0": [0, 0, 1, 0, 0, 0]}  # velocities of the keyframe
VELOCITIES: dict[str, tuple[str, dict[str, Any]]] = {
    "momentum": ("0", {"momentum": [0] * 6, "xi0": None}),
    "xi0": ("[0, 1, 0, 0, 0, 2]", {"xi0": [0, 1, 0, 0, 0, 2]}),
    "xdot0": ("[0.2]", {"xdot0": [0.2]}),
    "v0": ("[3, 0, 0, 0, 0, 0, -0.1]", {"xi0": [3, 0, 0, 0, 0, 0], "xdot0": [-0.1]}),
}


@pytest.mark.parametrize("name", VELOCITIES)
def test_keyframe_with_a_stated_velocity_keeps_everything_else(
    path: Path, tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """In Python, files and commands, the shape and the other velocities are the keyframe's."""
    written, changed = VELOCITIES[name]
    file = path.with_name("scene.toml")
    value: Any = tomllib.loads(f"v = {written}")["v"]
    head = 'robot = "robot.xml"\nload = {root = "robot"}\n[start]\nkeyframe = "home"\n'
    file.write_text(f"{head}{name} = {written}\n")
    system = pinred.load(path, root="robot")
    options: dict[str, Any] = {"keyframe": "home", name: value}
    out = tmp_path / "motion.npz"
    flag = f"--{name}={written.strip('[]').replace(' ', '')}"
    words = ("--keyframe", "home", flag, "--out", str(out))
    assert run(capsys, "simulate", str(path), *ROBOT, *words)[0] == 0
    expected: dict[str, Any] = KEPT | changed
    assert pinred.read_recording(out).xdot[0] == pytest.approx(expected["xdot0"])
    scenes = [pinred.Scene(system=system, **options), pinred.load_scene(file)]
    for scene in scenes:
        given = scene.given
        assert scene.start.x == pytest.approx([0.4])
        assert scene.start.pose[:3] == pytest.approx([1, 2, 3])
        assert given.xdot[0] == pytest.approx(expected["xdot0"])
        assert (given.xi is None) == (expected["xi0"] is None)
        if given.xi is not None:
            assert given.xi[0] == pytest.approx(expected["xi0"])
        else:
            assert given.mu is not None
            assert given.mu[0] == pytest.approx(expected["momentum"])
    rows: dict[str, Any] = {name: np.reshape(changed.get(name, value), (1, -1))}
    many = pinred.simulate_many(system, keyframe="home", **rows, duration=0.1)
    assert many.xdot[0, 0] == pytest.approx(expected["xdot0"])
