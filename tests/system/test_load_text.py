"""Tests of load(text=…): robots from the content of a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pinred
from pinred.simulation.read_recording import read_recording
from pinred.system.find_robot_files import bundled_robots
from pinred.views.playback.drawn_bodies import drawn_bodies

URDF = """<?xml version="1.0"?>
<robot name="boxes">
  <link name="base"><inertial><mass value="2"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="{mesh}"/></geometry></visual></link>
  <link name="tip"><inertial><origin xyz="1 0 0"/><mass value="1"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="elbow" type="continuous"><parent link="base"/><child link="tip"/>
    <axis xyz="0 1 0"/></joint>
</robot>"""
TRIANGLE = """solid t
facet normal 0 0 1\nouter loop
vertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0
endloop\nendfacet\nendsolid t\n"""
MJCF = """<mujoco model="arm"><default><geom contype="0" conaffinity="0"/></default><worldbody>
<body name="base"><freejoint/><geom size=".2"/>
<body name="tip" pos="1 0 0"><joint name="elbow" axis="0 1 0"/><geom size=".1"/></body></body>
</worldbody></mujoco>"""


def test_text_of_a_file_gives_the_system_of_the_file() -> None:
    """Equations, drawn bodies and name are those of the file."""
    path = bundled_robots()["falling_cat"].path
    a, b = pinred.load(path), pinred.load(text=path.read_text("utf-8"))
    assert b.name == "falling_cat"
    assert (a.group, a.shape_names) == (b.group, b.shape_names)
    x = np.linspace(0.1, 0.5, a.m)
    np.testing.assert_array_equal(
        pinred.Reduction(a).mass_matrix(x), pinred.Reduction(b).mass_matrix(x)
    )
    drawn = [[solid.kind for solid in drawn_bodies(system).solids] for system in (a, b)]
    assert drawn[0] == drawn[1]


def test_meshes_of_a_text_are_found_in_folders(tmp_path: Path) -> None:
    """`meshes` names the folder of relative mesh files."""
    (tmp_path / "part.stl").write_text(TRIANGLE, "utf-8")
    text = URDF.format(mesh="part.stl")
    with_folder = drawn_bodies(pinred.load(text=text, meshes=tmp_path))
    assert [solid.kind for solid in with_folder.solids] == ["mesh"]
    assert "mesh" not in {solid.kind for solid in drawn_bodies(pinred.load(text=text)).solids}


def test_mjcf_text_is_read_and_drawn() -> None:
    """MJCF is recognised by its outermost element."""
    pytest.importorskip("mujoco")
    system = pinred.load(text=MJCF)
    assert (system.name, system.group.name, system.shape_names) == ("arm", "SE3", ("elbow",))
    assert [solid.kind for solid in drawn_bodies(system).solids] == ["sphere", "sphere"]


def test_recording_of_a_text_names_no_source(tmp_path: Path) -> None:
    """The recording asks for the robot and accepts the file."""
    text = URDF.format(mesh="part.stl")
    traj = pinred.simulate(pinred.load(text=text), duration=0.1, seed=1)
    traj.save(tmp_path / "traj.npz")
    with pytest.raises(pinred.LoadError, match="does not say where its robot 'boxes' comes from"):
        _ = read_recording(tmp_path / "traj.npz").system
    (tmp_path / "boxes.urdf").write_text(text, "utf-8")
    recording = read_recording(tmp_path / "traj.npz", robot=str(tmp_path / "boxes.urdf"))
    assert recording.system.name == "boxes"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the text is empty"),
        ("no robot", "the text is not XML"),
        ("<robot name='r'>", "the text is not XML"),
        ("<house/>", r"the text, line 1: expected <robot> \(URDF\)"),
        ("<!DOCTYPE a><robot name='r'/>", "the text declares a document type"),
        ("\udc80", "the text is not XML in UTF-8; save it in this encoding"),
    ],
)
def test_invalid_text_is_refused_as_a_file_is(text: str, message: str) -> None:
    """The checks of files apply; the message names the text, not a temporary file."""
    with pytest.raises(pinred.LoadError, match=message):
        pinred.load(text=text)


def test_load_takes_either_source_or_text() -> None:
    """Neither and both are refused."""
    with pytest.raises(pinred.InputError, match="got neither"):
        pinred.load()
    with pytest.raises(pinred.InputError, match="got both"):
        pinred.load("falling_cat", text=MJCF)


def test_scene_file_in_place_of_a_robot_names_its_command(tmp_path: Path) -> None:
    """A reader ran `pinred compare scene.toml`."""
    scene = tmp_path / "scene.toml"
    scene.write_text('robot = "falling_cat"\n')
    with pytest.raises(pinred.LoadError, match=r"not XML: .*`pinred run`"):
        pinred.load(scene)
