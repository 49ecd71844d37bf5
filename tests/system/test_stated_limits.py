"""Limits of joints that a file states and no run enforces, in System.left_out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred.system.copy_model import without_mimics
from pinred.system.passive import EFFORT, POSITION, VELOCITY, stated_limits

_INERTIA = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
_LINK = f'<link name="%s"><inertial><mass value="1"/>{_INERTIA}</inertial></link>'


def write(folder: Path, *limits: tuple[str, str]) -> Path:
    """Write a chain of joints j0, j1, … of (type, attributes of <limit> or "")."""
    text = _LINK % "l0"
    for k, (kind, limit) in enumerate(limits):
        limited = f"<limit {limit}/>" if limit else ""
        text += _LINK % f"l{k + 1}"
        text += (
            f'<joint name="j{k}" type="{kind}"><parent link="l{k}"/><child link="l{k + 1}"/>'
            f'<axis xyz="0 0 1"/>{limited}</joint>'
        )
    path = folder / "robot.urdf"
    path.write_text(f'<robot name="r">{text}</robot>', "utf-8")
    return path


def kinds(system: pinred.System) -> dict[str, tuple[str, ...]]:
    """Return the names of what is left out, by kind."""
    return {left.what: left.names for left in system.left_out}


def test_urdf_limits_are_left_out_by_kind_without_a_warning(tmp_path: Path) -> None:
    """Each kind of limit has the joints that state it; filterwarnings refuses warnings."""
    path = write(
        tmp_path,
        ("revolute", 'lower="-1" upper="1" velocity="0" effort="0"'),
        ("revolute", 'lower="-1" upper="1" velocity="2" effort="3"'),
        ("continuous", 'velocity="2" effort="0"'),
        ("prismatic", 'lower="0" upper="1" velocity="0" effort="5"'),
        ("continuous", ""),
        ("revolute", ""),
    )
    system = pinred.load(path)
    assert kinds(system) == {
        POSITION: ("j0", "j1", "j3"), VELOCITY: ("j1", "j2"), EFFORT: ("j1", "j3"),
    }  # fmt: skip
    assert "velocity limits: j1, j2" in str(pinred.inspect(system))


def test_limits_of_locked_joints_are_not_listed(tmp_path: Path) -> None:
    """Limits of a locked joint do not matter; a planar joint counts as locked with all parts."""
    both = 'lower="-1" upper="1" velocity="2" effort="3"'
    path = write(
        tmp_path, ("revolute", both), ("planar", 'velocity="2" effort="3"'), ("revolute", both)
    )
    free = kinds(pinred.load(path))
    assert free[POSITION] == ("j0", "j2")
    assert "j1" in free[VELOCITY]
    locked = kinds(pinred.load(path, lock=["j0", "j1"]))
    assert locked == {POSITION: ("j2",), VELOCITY: ("j2",), EFFORT: ("j2",)}
    partly = kinds(pinred.load(path, lock=["j0", "j1.x"]))
    assert partly[VELOCITY] == ("j1", "j2")


def test_merged_hinges_list_their_position_limits_once() -> None:
    """Position limits of merged hinges have their own kind; their velocity limits remain."""
    raw = pin.Model()
    parent = 0
    for name, kind in zip(
        "abc", (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ), strict=True
    ):
        one = np.ones(1)
        parent = raw.addJoint(parent, kind(), pin.SE3.Identity(), name, one, one, -one, one)
    hinges = {left.what: left.names for left in stated_limits(raw)}
    assert hinges == {POSITION: tuple("abc"), VELOCITY: tuple("abc"), EFFORT: tuple("abc")}
    merged = {left.what: left.names for left in stated_limits(raw, merged={"a", "b"})}
    assert merged == hinges | {POSITION: ("c",)}


def test_models_with_mimic_joints_keep_the_limits_of_the_others() -> None:
    """Rebuilding a model without mimic joints keeps the limits of rates and efforts."""
    limit = '<limit lower="-1" upper="1" velocity="2" effort="3"/>'
    joints = "".join(
        f'<joint name="{name}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/>'
        f'<axis xyz="0 0 1"/>{limit}{mimic}</joint>'
        for k, (name, mimic) in enumerate(
            [("a", ""), ("b", '<mimic joint="a" multiplier="0.5"/>'), ("c", "")]
        )
    )
    links = "".join(_LINK % f"l{k}" for k in range(4))
    raw = pin.buildModelFromXML(f'<robot name="r">{links}{joints}</robot>', mimic=True)
    assert len(raw.mimicking_joints) == 1
    plain, _ = without_mimics(raw)
    left_out = {left.what: left.names for left in stated_limits(plain)}
    assert left_out == {POSITION: ("a", "c"), VELOCITY: ("a", "c"), EFFORT: ("a", "c")}


@pytest.mark.parametrize("name", ["falling_cat", "satellite_two_arms"])
def test_bundled_robots_list_the_limits_of_their_files(name: str) -> None:
    """All limited joints of bundled files state effort and velocity as well."""
    left_out = kinds(pinred.load(name))
    assert set(left_out) == {POSITION, VELOCITY, EFFORT}
    assert len({*left_out.values()}) == 1
