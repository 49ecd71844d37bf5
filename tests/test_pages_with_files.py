"""The code of pages that name files of the reader, run on small files of these names."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import robot_texts
import site_pages

import pinred
from pinred.system.find_robot_files import bundled_folder, has_example_robots

pytest.importorskip("mujoco")
_VALUE = re.compile(r"([-\w.,\[\]() ]+?)  # (\('.*?\)\)|\(\d+, \d+\)|'.*?').*")
_MASS = '<inertial pos="0 0 -0.1" mass="1" diaginertia="0.01 0.012 0.014"/>'


def hinge(name: str, axis: str = "0 1 0") -> str:
    """Return an MJCF hinge."""
    return f'<joint name="{name}" axis="{axis}"/>'


def body(name: str, *inside: str) -> str:
    """Return an MJCF body below its parent, with mass."""
    return f'<body name="{name}" pos="0 0.1 -0.2">{"".join(inside)}{_MASS}</body>'


def hip(name: str) -> str:
    """Return an MJCF body on three perpendicular hinges through one point."""
    axes = {"z": "0 0 1", "y": "0 1 0", "x": "1 0 0"}
    return body(name, *(hinge(f"{name}r{k}", axis) for k, axis in axes.items()))


def robot_files() -> dict[str, str]:
    """Return the robot files that docs/robots.md names, by their names."""
    free, leg = "<freejoint/>", body("leg", hinge("knee"))
    home = '<keyframe><key name="home" qpos="0 0 1 1 0 0 0 0.3 0.1"/></keyframe>'
    kettle = body("kettle", hinge("lid"))
    damped = f'{robot_texts.AXIS}<dynamics damping="0.1" friction="0.05"/>'
    links = robot_texts.link("thigh"), robot_texts.link("shin")
    return {
        "half_cheetah.xml": robot_texts.mjcf(body("torso", free, leg)),
        "kitchen.xml": robot_texts.mjcf(body("robot", free, leg) + kettle, home),
        "robot.xml": robot_texts.mjcf(body("robot", free, leg)),
        "humanoid.xml": robot_texts.mjcf(body("root", free, hip("lfemur"), hip("head"))),
        "four_bar.urdf": (bundled_folder() / "four_bar.urdf").read_text("utf-8"),
        "robot.urdf": robot_texts.robot(*links, robot_texts.joint("thigh", "shin", content=damped)),
        "arm.sdf": f'<sdf version="1.9">{sdf_model("arm")}</sdf>',
        "world.sdf": (
            f'<sdf version="1.9"><world name="w">{sdf_model("arm")}{sdf_model("box")}</world></sdf>'
        ),
    }


def sdf_model(name: str) -> str:
    """Return an SDF model of one link."""
    return f'<model name="{name}"><link name="base"/></model>'


@pytest.mark.by_hand
@pytest.mark.filterwarnings("ignore::UserWarning")  # the page says which warnings to expect
def test_code_of_page_on_robots_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All blocks run in order, and the comments in the block on followers tell their values."""
    if not has_example_robots():
        pytest.skip("example-robot-data is not installed")
    import mujoco

    pytest.importorskip("pydrake")
    for name, text in robot_files().items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    (tmp_path / "models").mkdir()
    monkeypatch.chdir(tmp_path)
    scope = {"pinred": pinred, "mujoco": mujoco, "np": np}
    values = {}
    for block in site_pages.python_blocks((site_pages.DOCS / "robots.md").read_text("utf-8")):
        exec(compile(block, "robots.md", "exec"), scope)
        for line in block.splitlines():
            if found := _VALUE.fullmatch(line):
                values[line] = eval(found[1], scope) == eval(found[2])
    assert len(values) == 3
    assert all(values.values()), values


@pytest.mark.by_hand
def test_code_of_page_on_scenes_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The scene file and the code of docs/scenes.md run."""
    text = (site_pages.DOCS / "scenes.md").read_text("utf-8")
    (tables,) = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    force = '[[forces]]\nkind = "torque"\nfunction = { bend = "-gain*x[\'bend\']" }\n'
    scene = f'robot = "falling_cat"\nrun.duration = 0.5\n{tables}{force}'
    (tmp_path / "scene.toml").write_text(scene, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    (code,) = site_pages.python_blocks(text)
    scope = {"pinred": pinred}
    exec(compile(code, "scenes.md", "exec"), scope)
    assert isinstance(scope["traj"], pinred.Trajectory)


@pytest.mark.by_hand
def test_code_of_page_on_playback_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All blocks run, without opening a browser or waiting for Ctrl-C."""
    for package in ("viser", "rerun"):
        pytest.importorskip(package)
    monkeypatch.chdir(tmp_path)
    players: list[Any] = []

    def play(*arguments: Any, **options: Any) -> Any:
        player = original(*arguments, **{**options, "wait": False, "show": False})
        players.append(player)
        return player

    def save_film(motion: pinred.Trajectory, name: str) -> None:
        write_film(motion, Path(name).with_suffix(".gif"), fps=1)  # mp4 needs ffmpeg

    original, write_film = pinred.play, pinred.save_film
    monkeypatch.setattr(pinred, "save_film", save_film)
    monkeypatch.setattr(pinred, "play", play)
    text = (site_pages.DOCS / "playback.md").read_text("utf-8")
    exec(compile("\n".join(site_pages.python_blocks(text)), "playback.md", "exec"), {})
    for player in players:
        player.close()
    assert len(players) == 4
    assert (tmp_path / "cat.html").stat().st_size > 1e5
