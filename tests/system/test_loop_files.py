"""YAML files with loops and joint types beside a URDF, as in example-parallel-robots."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import pinred
import pinred.forces
from pinred.cli.command_line import main
from pinred.common.errors import InputError, LoadError, MissingPackageError
from pinred.system.loops.loop import Loop, read_loop_file
from pinred.views.playback.drawn_bodies import drawn_bodies

YAML = """\
closed_loop: [['end', 'rocker']]
type: ['3D']
name_mot: ['crank']
joint_name: ['end']
joint_type: ['SPHERICAL']
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with a five-bar as URDF and its loops as YAML."""
    (tmp_path / "robot.urdf").write_text(URDF)
    (tmp_path / "robot.yaml").write_text(YAML)
    return tmp_path


def test_loops_and_joint_types_are_read_beside_the_robot(folder: Path) -> None:
    """A name without a folder is searched beside the URDF; damping of other joints stays."""
    system = pinred.load(folder / "robot.urdf", group="SE3", loops="robot.yaml")
    assert system.loops == (Loop("end", "rocker", "3d"),)
    assert [ball.name for ball in system.space.balls] == ["end"]
    assert system.passive == (pinred.forces.Damper("crank", 0.2),)
    same = pinred.load(folder / "robot.urdf", group="SE3", loops=folder / "robot.yaml")
    assert (same.m, same.shape_dim) == (system.m, system.shape_dim) == (6, 4)


def test_motion_with_a_loop_file_equals_the_model_built_by_hand(folder: Path) -> None:
    """CARDAN replaces the hinge by two, as in example-parallel-robots."""
    (folder / "robot.yaml").write_text(YAML.replace("SPHERICAL", "CARDAN"))
    system = pinred.load(folder / "robot.urdf", group="SE3", loops="robot.yaml")
    assert system.shape_names == ("crank", "coupler", "end_X", "end_Y", "rocker")
    solids = drawn_bodies(system, meshes=False).solids  # the body between the hinges has no mass
    assert sum(solid.kind == "ellipsoid" for solid in solids) == 5
    (folder / "robot.yaml").write_text(YAML.replace("SPHERICAL", "UJOINT_ZX"))
    other = pinred.load(folder / "robot.urdf", group="SE3", loops="robot.yaml")
    assert other.shape_names == ("crank", "coupler", "end_Z", "end_X", "rocker")
    hinge = pin.buildModelFromUrdf(str(folder / "robot.urdf"), pin.JointModelFreeFlyer())
    at = hinge.jointPlacements[hinge.getJointId("end")]
    joint = system.model.getJointId("end_X")
    assert system.model.jointPlacements[joint].isApprox(at)
    x, c, s = np.array([0.1, 0.2, 0.3, 0.4, 0.5]), np.cos, np.sin
    data = system.model.createData()
    pin.framesForwardKinematics(system.model, data, system.q([0] * 6 + [1], x))
    before, after = (
        data.oMf[system.model.getFrameId(name, pin.FrameType.BODY)].rotation
        for name in ("coupler", "end")
    )
    turn = before.T @ after
    about_x = np.array([[1, 0, 0], [0, c(0.3), -s(0.3)], [0, s(0.3), c(0.3)]])
    about_y = np.array([[c(0.4), 0, s(0.4)], [0, 1, 0], [-s(0.4), 0, c(0.4)]])
    np.testing.assert_allclose(turn, about_x @ about_y, atol=1e-14)


def test_commands_and_scene_files_accept_loop_files(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Paths in a scene file are relative to it."""
    robot = str(folder / "robot.urdf")
    options = ["--group", "SE3", "--loops", str(folder / "robot.yaml")]
    assert main(["inspect", robot, *options]) == 0
    assert "end = rocker (3d)" in capsys.readouterr().out
    (folder / "scene.toml").write_text(
        "robot = 'robot.urdf'\n[run]\nduration = 0.2\n[start]\nseed = 1\n"
        "[load]\ngroup = 'SE3'\nloops = 'robot.yaml'\n"
    )
    assert pinred.load_scene(folder / "scene.toml").system.loops == (Loop("end", "rocker"),)


WRONG = {
    "closed_lop: []": r"robot.yaml: unknown key 'closed_lop'; the keys are closed_loop, type",
    "[1, 2]": r"robot.yaml: expected the keys closed_loop.*, got \[1, 2\]",
    "closed_loop: [['end']]": "closed_loop: expected pairs of names",
    "closed_loop: [['end', 'rocket']]": "closed_loop: the robot has no link or frame 'rocket'; "
    "did you mean 'rocker'",
    "closed_loop: [['end', 'rocker']]\ntype: ['5d']": "type: expected one of 3d, 6d.*got '5d'",
    "closed_loop: [['end', 'rocker']]\ntype: []": "type: expected a kind for each of the 1 entries",
    "joint_name: ['ent']\njoint_type: ['FIXED']": "joint_name: the robot has no joint 'ent'",
    "joint_name: ['end']\njoint_type: ['HINGE']": "joint_type: expected one of SPHERICAL.*'HINGE'",
    "joint_name: ['end']\njoint_type: ['UJOINT_XX']": "joint_type: expected one of SPHERICAL",
    "joint_name: ['end']": "joint_type: expected a type for each of the 1 entries",
}


@pytest.mark.parametrize("text", WRONG)
def test_wrong_loop_files_are_refused_with_file_key_and_names(text: str, folder: Path) -> None:
    """A user can mend the file from the message."""
    (folder / "robot.yaml").write_text(text)
    with pytest.raises(InputError, match=WRONG[text]):
        pinred.load(folder / "robot.urdf", group="SE3", loops="robot.yaml")


def test_loop_file_executes_nothing(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tags of Python objects are refused; missing files and a missing PyYAML have messages."""
    marker = folder / "executed"
    (folder / "robot.yaml").write_text(
        f"closed_loop: !!python/object/apply:pathlib.Path.touch [!!python/name:x {marker}]\n"
    )
    with pytest.raises(LoadError, match=r"robot.yaml is not YAML in line 1"):
        read_loop_file(folder / "robot.yaml")
    assert not marker.exists()
    with pytest.raises(LoadError, match=r"no such file: .*other.yaml"):
        pinred.load(folder / "robot.urdf", loops="other.yaml")
    monkeypatch.setitem(sys.modules, "yaml", None)
    with pytest.raises(MissingPackageError, match=r"pinred\[yaml\]"):
        read_loop_file(folder / "robot.yaml")


def test_fixed_joints_of_a_loop_file_are_locked(folder: Path) -> None:
    """FIXED locks a joint at zero."""
    (folder / "robot.yaml").write_text(
        "closed_loop: [['end', 'rocker']]\njoint_name: ['end']\njoint_type: ['FIXED']\n"
        "type: ['y']\n"
    )
    system = pinred.load(folder / "robot.urdf", group="SE3", loops="robot.yaml")
    assert system.shape_names == ("crank", "coupler", "rocker")


def _link(name: str, parent: str = "", x: float = 0.0) -> str:
    body = (
        f'<link name="{name}"><inertial><origin xyz="0.2 0 0"/><mass value="1"/><inertia '
        'ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )
    damping = '<dynamics damping="0.2"/>' if name == "crank" else ""
    joint = (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{name}"/>'
        f'<origin xyz="{x} 0 0"/><axis xyz="0 1 0"/>{damping}'
        '<limit effort="1" velocity="20" lower="-3" upper="3"/></joint>'
    )
    return body + (joint if parent else "")


URDF = (
    '<robot name="five">'
    + _link("frame")
    + _link("crank", "frame")
    + _link("coupler", "crank", 0.4)
    + _link("end", "coupler", 0.9)
    + _link("rocker", "frame", 1.0)
    + "</robot>"
)
