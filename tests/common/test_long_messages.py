"""Messages are short, however long the names and values of users are."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinred
from pinred.cli.command_line import main
from pinred.common.errors import shorten_message
from pinred.forces import Damper

LONG = "a" * 10_000
SPACED = "ab " * 4_000
MOST = 2000
URDF = """<robot name="{name}"><link name="{name}"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="b{name}"><inertial><mass value="{mass}"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="{name}" type="revolute"><parent link="{name}"/><child link="{child}"/>
<axis xyz="0 0 1"/><limit effort="1" velocity="1"/></joint></robot>"""


def test_shorten_message_keeps_short_texts_and_both_ends() -> None:
    """Words and messages lose their middle; a second shortening changes nothing."""
    text = f"no joint '{'x' * 150}' of " + "names, " * 200
    assert shorten_message(text) == text
    short = shorten_message(f"start {LONG} end")
    assert short.startswith("start aaa")
    assert short.endswith("aaa end")
    assert len(short) == 210
    assert len(shorten_message(SPACED)) == MOST
    assert shorten_message(shorten_message(SPACED)) == shorten_message(SPACED)


@pytest.mark.parametrize("name", [LONG, SPACED, "\n" * 10_000, "'" * 10_000, "\ud800" * 10_000])
def test_errors_of_python_are_short(name: str) -> None:
    """Names of joints, robots, options, formulas and files are shortened."""
    cat = pinred.load("falling_cat")
    scene = pinred.Scene(system=cat, duration=0.1)
    calls: list[Callable[[], Any]] = [
        lambda: pinred.load(name),
        lambda: pinred.load("falling_cat", lock={name: 0.0}),
        lambda: pinred.load("falling_cat", balls=[name]),
        lambda: pinred.load("falling_cat", group=name),
        lambda: pinred.load("falling_cat", root=name),
        lambda: pinred.load("falling_cat", loops=name),
        lambda: pinred.load("falling_cat", parameters={name: 1.0}),
        lambda: pinred.simulate(cat, duration=0.1, x0={name: 0.0}),
        lambda: pinred.simulate(cat, duration=0.1, method=name),
        lambda: pinred.simulate(cat, duration=0.1, keyframe=name),
        lambda: pinred.simulate(cat, duration=0.1, parameters={name: 1.0}),
        lambda: pinred.simulate(cat, duration=0.1, forces=[Damper(name, 0.1)]),
        lambda: pinred.simulate(cat, duration=0.1, springs={name: (1.0, 0.0)}),
        lambda: pinred.simulate(cat, duration=0.1, prescribed={name: "sin(t)"}),
        lambda: pinred.simulate(cat, duration=0.1, prescribed={"bend": f"sin({name})"}),
        lambda: pinred.simulate(cat, duration=0.1, events=[pinred.Event(name)]),
        lambda: pinred.signals.Expression(name),
        lambda: pinred.sweep(scene, {name: [1.0]}),
        lambda: pinred.sweep(scene, {"front.mass": name}),
        lambda: pinred.sweep(scene, {"front.mass": [1.0]}, outputs={name: "x"}),
        lambda: pinred.sweep(scene, {"front.mass": [1.0]}, outputs={"x": name}),
        lambda: pinred.sweep(scene, {"front.mass": [1.0]}, store=name),
        lambda: pinred.flow(scene, wrt=[name]),
        lambda: pinred.plot(pinred.simulate(scene), name),
        lambda: pinred.read_recording(name),
        lambda: pinred.load_scene(name),
        lambda: pinred.Gait.read(name),
        lambda: pinred.Gait.fourier(name, [[1.0]], [[0.0]]),
        lambda: pinred.simulate(scene).save(name),
        lambda: pinred.Connection.mechanical(cat).seen_from(name),
        lambda: pinred.lie.group_named(name),
    ]
    for call in calls:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            with pytest.raises(pinred.PinredError) as error:
                call()
        assert len(str(error.value)) <= MOST
        assert all(len(str(warning.message)) <= MOST for warning in caught)


def run(words: list[str]) -> int:
    """Run a command; return its exit code, also if its arguments are rejected."""
    try:
        return main(words)
    except SystemExit as end:
        return int(end.code or 0)


def read_robot(path: Path) -> object:
    """Return the robot of a recording."""
    return pinred.read_recording(path).system


SCENES = [
    'robot = "{}"',
    'robot = "falling_cat"\n"{}" = 1',
    'robot = "falling_cat"\n[run]\nduration = 0.1\n"{}" = 1',
    'robot = "falling_cat"\n[start]\nx0 = {{ "{}" = 1 }}\n[run]\nduration = 0.1',
    'robot = "falling_cat"\n[run]\nduration = 0.1\nmethod = "{}"',
    'robot = "falling_cat"\n[run]\nduration = 0.1\n[springs]\n"{}" = [1, 0]',
    'robot = "falling_cat"\n[run]\nduration = 0.1\n[prescribed]\nbend = "sin({})"',
    'robot = "falling_cat"\n[run]\nduration = 0.1\n[[forces]]\nkind = "{}"',
    'robot = "falling_cat"\n[run]\nduration = 0.1\n[[forces]]\nkind = "damper"\njoint = "{}"',
    'robot = "falling_cat"\n[load]\nlock = {{ "{}" = 1 }}\n[run]\nduration = 0.1',
    '{} = = "',
]  # fmt: skip


@pytest.mark.parametrize("name", [LONG, SPACED.strip()])
def test_errors_of_files_are_short(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Names in scene files, robot files and recordings are shortened, also on the command line."""
    path = tmp_path / "scene.toml"
    for text in SCENES:
        path.write_text(text.format(name), encoding="utf-8")
        with pytest.raises(pinred.PinredError) as error:
            pinred.load_scene(path)
        assert len(str(error.value)) <= MOST
        assert run(["run", str(path)]) == 2
        assert len(capsys.readouterr().err) <= MOST + 100
    robot = tmp_path / "robot.urdf"
    for child, mass in ((f"b{name}", -1.0), ("missing", 1.0), (name, 1.0)):
        robot.write_text(URDF.format(name=name, child=child, mass=mass))
        with pytest.raises(pinred.PinredError) as error:
            pinred.load(robot)
        assert len(str(error.value)) <= MOST
    recording = tmp_path / "m.npz"
    pinred.simulate(pinred.load("falling_cat"), duration=0.1).save(recording)
    content = dict(np.load(recording))
    for key in ("group", "source"):
        np.savez(recording, **{**content, key: np.array(name)})
        with pytest.raises(pinred.PinredError) as error:
            read_robot(recording)
        assert len(str(error.value)) <= MOST


@pytest.mark.parametrize("name", [LONG, SPACED, os.fsdecode(b"\xff" * 3000)])
def test_errors_of_commands_are_short(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Names of commands, options, robots and files are shortened."""
    for words in (
        [name], ["inspect", name], ["inspect", "falling_cat", f"--{name}"],
        ["inspect", "falling_cat", "--group", name], ["inspect", "falling_cat", "--lock", name],
        ["simulate", "falling_cat", "--duration", name], ["simulate", "falling_cat", "--out", name],
        ["plot", "falling_cat", "--kind", name, "--out", "a.png"], ["gait", name],
        ["plot", f"{name}.csv", "--kind", "shape", "--out", "a.png"],
        ["simulate", "falling_cat", "--method", name], ["sweep", name], ["play", f"{name}.npz"],
    ):  # fmt: skip
        assert run(words) == 2
        assert len(capsys.readouterr().err) <= MOST + 200, words[0]
