"""Attitudes of ball joints by name: Python, the command line and scene files say the same."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinred
from pinred import InputError
from pinred.cli.command_line import _parser
from pinred.cli.command_options import scene_of, shape_in
from pinred.common.arrays import Array
from pinred.signals import Attitude, Fourier, Spline

FILE = """
robot = "diver"
[start]
x0 = { hips = [0.1, 0.0, 0.3], left_shoulder = [0, 0, 1, 1] }
xdot0 = { hips = [1, 0, 2], "left_shoulder.y" = 0.5 }
"""


def test_file_command_line_and_python_state_the_same_attitudes(tmp_path: Path) -> None:
    """Rotation vectors of three numbers, quaternions of four, and rates along axes."""
    x0: dict[str, Any] = {"hips": [0.1, 0.0, 0.3], "left_shoulder": [0, 0, 1, 1]}
    xdot0: dict[str, Any] = {"hips": [1, 0, 2], "left_shoulder.y": 0.5}
    start = pinred.Scene(system=pinred.load("diver"), x0=x0, xdot0=xdot0).start
    path = tmp_path / "scene.toml"
    path.write_text(FILE, encoding="utf-8")
    in_file = pinred.load_scene(path).start
    np.testing.assert_array_equal(in_file.x, start.x)
    np.testing.assert_array_equal(in_file.xdot, start.xdot)
    typed: Any = shape_in("hips=.1,0,.3,left_shoulder=0,0,1,1", "x0")
    rates: Any = shape_in("hips=1,0,2,left_shoulder.y=.5", "xdot0")
    on_command_line = pinred.Scene(system=pinred.load("diver"), x0=typed, xdot0=rates).start
    np.testing.assert_array_equal(on_command_line.x, start.x)
    np.testing.assert_array_equal(on_command_line.xdot, start.xdot)
    np.testing.assert_allclose(start.x[4:8], [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)], atol=1e-16)


TURNS = [[0.0, 0.0, 0.0], [2.5, 0.0, 0.0], [-2.5, 0.0, 0.0]]
PLANS: dict[str, tuple[Any, str, str]] = {
    "formulas": (
        ["0.3*sin(t)", 0.1, "atan2(t, 2)"],
        "['0.3*sin(t)', 0.1, 'atan2(t, 2)']",
        "0.3*sin(t),0.1,atan2(t, 2)",
    ),
    "constant quaternion": ([0, 0, 1, 1], "[0, 0, 1, 1]", "0,0,1,1"),
    "about a centre": (
        Attitude(["t", 0, 0.2], (0.1, 0, 0.5)),
        "{ attitude = { vector = ['t', 0, 0.2], centre = [0.1, 0, 0.5] } }",
        "t,0,0.2@0.1,0,0.5",
    ),
    "components of several kinds": (
        Attitude([Fourier(0.0, [], [0.1], 2.0), Spline([0, 2], [0.0, 0.3]), 0]),
        "[{ fourier = { sines = [0.1], period = 2 } }, "
        "{ spline = { times = [0, 2], values = [0, 0.3] } }, 0]",
        "",
    ),
    "through attitudes": (
        Attitude.through([0, 1, 2], TURNS, end="clamped"),
        "{ attitude = { times = [0, 1, 2], end = 'clamped', "
        "attitudes = [[0, 0, 0], [2.5, 0, 0], [-2.5, 0, 0]] } }",
        "",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", PLANS)
def test_file_command_line_and_python_prescribe_the_same_attitude(
    name: str, tmp_path: Path
) -> None:
    """The force models contain the motions; their expressions and numbers are equal."""
    plan, in_file, typed = PLANS[name]
    path = tmp_path / "scene.toml"
    path.write_text(f"robot = 'diver'\nprescribed.hips = {in_file}\n", encoding="utf-8")
    scenes = [
        pinred.Scene(system=pinred.load("diver"), seed=0, prescribed={"hips": plan}),
        pinred.load_scene(path),
    ]
    if typed:
        words = ["compare", "diver", "--seed", "0", "--prescribed", f"hips={typed}"]
        scenes.append(scene_of(_parser(words).parse_args(words)))
    models = [scene.force_model for scene in scenes]
    assert len({model.key for model in models if model is not None}) == 1
    assert len({tuple(model.numbers) for model in models if model is not None}) == 1
    # A pickled scene keeps the motion.
    again = pickle.loads(pickle.dumps(scenes[0])).force_model
    np.testing.assert_array_equal(again.prescribed(0.3, again.numbers).x, _attitude_at(scenes[1]))


def _attitude_at(scene: pinred.Scene) -> Array:
    """Return the prescribed quaternion at 0.3 s."""
    model = scene.force_model
    assert model is not None
    return model.prescribed(0.3, model.numbers).x


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("hips = [1, 2]", "prescribed.hips: vector of an Attitude: expected three signals"),
        ("hips = 't'", r"prescribed\['hips'\] is a ball joint: expected an Attitude"),
        ("hips = [0, 't +', 0]", "prescribed.hips.1.: the expression cannot be used"),
        ("hips = { attitude = { centre = [0, 0, 1] } }",
         "prescribed.hips.attitude: must have one of the keys vector, times"),
        ("hips = { attitude = { times = [0, 1], attitudes = [[0, 0, 0], [0, 1]] } }",
         "prescribed.hips.attitude: "),
    ],
)  # fmt: skip
def test_wrong_prescribed_attitude_in_file_is_refused(
    tmp_path: Path, line: str, message: str
) -> None:
    """The message names the joint, and the place in the file."""
    path = tmp_path / "scene.toml"
    path.write_text(f'robot = "diver"\n[prescribed]\n{line}\n', encoding="utf-8")
    with pytest.raises(pinred.PinredError, match=message):
        pinred.load_scene(path)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ('x0 = { hip = [0.1, 0, 0] }', "start.x0.hip: unknown joint \"hip\"; did you mean 'hips'"),
        ('x0 = { hips = 0.1 }', r"\['hips'\] is a ball joint: expected a rotation vector"),
        ('x0 = { hips = [0, 0, 0, 0] }', "quaternion of a ball joint must not be zero"),
    ],
)  # fmt: skip
def test_wrong_attitude_in_file_is_refused(tmp_path: Path, line: str, message: str) -> None:
    """The message names the joint, and the place in the file."""
    path = tmp_path / "scene.toml"
    path.write_text(f'robot = "diver"\n[start]\n{line}\n', encoding="utf-8")
    with pytest.raises((InputError, pinred.ShapeError), match=message):
        pinred.load_scene(path)
