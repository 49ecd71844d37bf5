"""Attitudes of ball joints by name: Python, the command line and scene files say the same."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinred
from pinred import InputError
from pinred.cli.option_values import shape_in

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
