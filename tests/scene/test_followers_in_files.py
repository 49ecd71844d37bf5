"""Scene files of robots with mimic joints."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from robot_texts import joint, link, robot, write

import pinred
from pinred import InputError

MIMIC = '<axis xyz="0 1 0"/><mimic joint="left" multiplier="-2" offset="0.1"/>'
HAND = robot(
    *(link(name) for name in "abc"),
    joint("a", "b").replace('"a-b"', '"left"'),
    joint("a", "c", content=MIMIC).replace('"a-c"', '"right"'),
)


def scene(folder: Path, text: str) -> pinred.Scene:
    """The scene in a file beside the robot's."""
    write(folder, HAND)
    path = folder / "scene.toml"
    path.write_text(f'robot = "arm.urdf"\n[start]\nx0 = [0.2]\n[run]\nduration = 0.3\n{text}')
    return pinred.load_scene(path)


FORCES = """
[springs]
right = [3.0, 0.5]
[[forces]]
kind = "damper"
joint = "right"
coefficient = 0.2
[[forces]]
kind = "torque"
function = { left = "x['right'] - xdot['right']", right = "cos(x['left'])" }
[[forces]]
kind = "potential"
function = "0.3*x['right']**2"
"""


def test_mimic_joint_force_from_file_matches_python(tmp_path: Path) -> None:
    """Forces on mimic joints, and formulas with their positions, match the scene in Python."""
    traj = pinred.simulate(scene(tmp_path, FORCES))
    k, b = -2.0, 0.1

    def torque(_t: Any, x: Any, xdot: Any, _mu: Any) -> dict[str, Any]:
        there = k * x[0] + b
        through = ca.cos(x[0]) - 0.2 * k * xdot[0] - 3.0 * (there - 0.5) - 2.0 * 0.3 * there
        return {"left": there - k * xdot[0] + k * through}

    direct = pinred.simulate(
        pinred.load(tmp_path / "arm.urdf"), x0=[0.2], duration=0.3,
        forces=[pinred.forces.Torque(torque)],
    )  # fmt: skip
    np.testing.assert_allclose(traj.x, direct.x, atol=1e-10)


@pytest.mark.parametrize(
    ("text", "where"), [('[prescribed]\nright = "t"\n', "prescribed"), ("[oops]\n", "oops")]
)
def test_mimic_joint_error_names_the_key(tmp_path: Path, text: str, where: str) -> None:
    """The error message names file, line and key."""
    with pytest.raises(InputError, match=where) as caught:
        scene(tmp_path, text)
    if where == "prescribed":
        assert "'right' follows 'left' (right = -2·left + 0.1)" in str(caught.value)


def test_mimic_joint_initial_value_is_refused(tmp_path: Path) -> None:
    """A mimic joint has no initial value."""
    write(tmp_path, HAND)
    path = tmp_path / "scene.toml"
    path.write_text('robot = "arm.urdf"\n[start]\nx0 = { right = 0.2 }\n')
    with pytest.raises(InputError, match=r"x0.*'right' follows 'left'"):
        pinred.load_scene(path)
