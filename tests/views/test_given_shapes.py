"""Shapes that are given with a model, and search folders for meshes."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred.cli.command_line import main
from pinred.system.find_robot_files import has_example_robots
from pinred.views.playback.drawn_bodies import Bodies, drawn_bodies

needs_robots = pytest.mark.skipif(
    not has_example_robots(), reason="example-robot-data is not installed"
)


def wrapper(name: str) -> Any:
    """Return a RobotWrapper of example-robot-data."""
    import example_robot_data

    return example_robot_data.load(name)


def assert_same_bodies(one: Bodies, other: Bodies) -> None:
    """Assert equal shapes, placements and meshes."""
    assert [(s.joint, s.kind, s.size) for s in one.solids] == [
        (s.joint, s.kind, s.size) for s in other.solids
    ]
    for a, b in zip(one.solids, other.solids, strict=True):
        np.testing.assert_allclose(a.placement, b.placement, atol=1e-12)
    for mesh, same in zip(one.meshes, other.meshes, strict=True):
        np.testing.assert_array_equal(mesh.vertices, same.vertices)
        np.testing.assert_array_equal(mesh.faces, same.faces)


# The other case has frozen joints.
@pytest.mark.by_hand("lock0")
@needs_robots
@pytest.mark.parametrize("lock", [(), {"FL_HFE": 0.7, "HR_KFE": -0.4}])
def test_wrapper_equals_robot_by_name(lock: Any) -> None:
    """Dynamics and shapes agree, with or without frozen joints, as wrapper or as pair."""
    robot, named = wrapper("solo12"), pinred.load("solo12", lock=lock)
    for source in (robot, (robot.model, robot.visual_model)):
        system = pinred.load(source, lock=lock)
        assert system.shape_names == named.shape_names
        assert system.group is named.group
        rng = np.random.default_rng(0)
        reach = np.ones(named.model.nq)
        q = pin.randomConfiguration(named.model, -reach, reach)
        v, tau = rng.normal(size=(2, named.n))
        result, wanted = (
            pin.aba(s.model, s.model.createData(), q, v, tau) for s in (system, named)
        )
        np.testing.assert_allclose(result, wanted, rtol=1e-10, atol=1e-10)
        drawn = drawn_bodies(system)
        assert drawn.note == ""
        assert len(drawn.meshes) == 10
        assert_same_bodies(drawn, drawn_bodies(named))


# The previous test compares all meshes of the wrapper.
@pytest.mark.by_hand
@needs_robots
def test_page_of_wrapper_contains_meshes(tmp_path: Path) -> None:
    """As many as the page of the robot by name, without a remark on inertias."""
    robot = wrapper("solo12")
    pages = []
    for source in (robot, "solo12"):
        path = tmp_path / "page.html"
        traj = pinred.simulate(pinred.load(source), seed=1, duration=0.05, engine="pinocchio")
        pinred.save_html(traj, path, fps=20)
        pages.append(path.read_text("utf-8"))
    counts = [len(re.findall(r'"kind": ?"mesh"', page)) for page in pages]
    assert counts[0] == counts[1]
    assert "drawn from their inertias" not in pages[0]
    assert abs(len(pages[0]) - len(pages[1])) < 200


def test_shapes_on_joints_without_frames() -> None:
    """A manual pair has its shape on the joint; a frozen joint is reported."""
    model = pin.Model()
    ball = pin.Inertia.FromSphere(1.0, 0.2)
    base = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    hinge = model.addJoint(base, pin.JointModelRZ(), pin.SE3.Random(), "hinge")
    for joint in (base, hinge):
        model.appendBodyToJoint(joint, ball, pin.SE3.Identity())
    geometry, place = pin.GeometryModel(), pin.SE3.Random()
    shape = pin.GeometryObject("stone", hinge, place, import_module("coal").Sphere(0.3))
    geometry.addGeometryObject(shape)
    drawn = drawn_bodies(pinred.load((model, geometry)))
    (stone,) = drawn.solids
    assert (stone.joint, stone.kind, stone.size) == (2, "sphere", (0.3,))
    np.testing.assert_allclose(
        pin.XYZQUATToSE3(stone.placement).homogeneous, place.homogeneous, atol=1e-12
    )
    note = drawn_bodies(pinred.load((model, geometry), lock=["hinge"])).note
    assert "'stone' is attached to joint 'hinge', which is locked" in note
    nothing = drawn_bodies(pinred.load((model, pin.GeometryModel())))
    assert "there are no shapes with the model" in nothing.note
    assert {solid.kind for solid in nothing.solids} <= {"ellipsoid", "capsule"}
    small = pin.Model()
    small.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    with pytest.raises(pinred.InputError, match="'stone' is attached to joint 2"):
        pinred.load((small, geometry))


@pytest.mark.parametrize("source", [(1, 2), (pin.Model(),), (pin.Model(), 3)])
def test_invalid_pairs_are_rejected(source: Any) -> None:
    """The message says what is expected."""
    with pytest.raises(pinred.InputError, match="GeometryModel"):
        pinred.load(source)


URDF = (
    '<robot name="r"><link name="b"><inertial><mass value="1"/><inertia ixx="1" iyy="1" '
    'izz="1" ixy="0" ixz="0" iyz="0"/></inertial><visual><geometry><mesh '
    'filename="package://urdf_and_package/meshes/tip.stl"/></geometry></visual></link></robot>'
)
STL = (
    "solid s\n facet normal 0 0 1\n  outer loop\n   vertex 0 0 0\n   vertex 1 0 0\n"
    "   vertex 0 1 0\n  endloop\n endfacet\nendsolid s\n"
)


@pytest.fixture
def urdf_and_package(tmp_path: Path) -> tuple[Path, Path]:
    """Write a URDF, and the package of its mesh in another folder."""
    (tmp_path / "robots").mkdir()
    robot = tmp_path / "robots/r.urdf"
    robot.write_text(URDF)
    package = tmp_path / "elsewhere/urdf_and_package"
    (package / "meshes").mkdir(parents=True)
    (package / "meshes/tip.stl").write_text(STL)
    return robot, package


def test_meshes_option_names_folders(urdf_and_package: tuple[Path, Path], tmp_path: Path) -> None:
    """The package or its parent folder, in load, in views, in scenes, in play."""
    robot, package = urdf_and_package
    without = drawn_bodies(pinred.load(robot))
    missing = "mesh 'package://urdf_and_package/meshes/tip.stl' of link 'b' could not be found"
    assert missing in without.note
    for folder in (package, str(package.parent), [tmp_path, package]):
        for drawn in (
            drawn_bodies(pinred.load(robot, meshes=folder)),
            drawn_bodies(pinred.load(robot), meshes=folder),
        ):
            assert drawn.note == ""
            assert len(drawn.meshes) == 1
    scene = tmp_path / "scene.toml"
    scene.write_text(
        "robot = 'robots/r.urdf'\nload = { meshes = 'elsewhere' }\nstart = { seed = 1 }\n"
        "run = { duration = 0.05 }\n"
    )
    assert drawn_bodies(pinred.load_scene(scene).system).note == ""
    traj = pinred.simulate(pinred.load(robot), seed=1, duration=0.05)
    motion, page = tmp_path / "m.npz", tmp_path / "m.html"
    traj.save(motion)
    for words, said in (([], True), (["--meshes", str(package)], False)):
        named = ["--robot", str(robot)]  # which is not beside the recording
        assert main(["play", str(motion), "--out", str(page), *named, *words]) == 0
        assert ("could not be found" in page.read_text("utf-8")) == said


def test_missing_folders_are_rejected(
    urdf_and_package: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    """Folders without use are rejected too."""
    robot, package = urdf_and_package
    with pytest.raises(pinred.InputError, match="no folder 'gone'"):
        pinred.load(robot, meshes="gone")
    with pytest.raises(pinred.InputError, match="a folder or a list"):
        pinred.load(robot, meshes=3)  # type: ignore[arg-type]
    with pytest.raises(pinred.InputError, match="to robots from files"):
        pinred.load(pin.buildModelFromUrdf(str(robot)), meshes=package)
    xml = robot.with_suffix(".xml")
    xml.write_text("<mujoco><worldbody/></mujoco>")
    with pytest.raises(pinred.InputError, match="meshes= applies to URDF and SDF"):
        pinred.load(xml, meshes=package)
    assert main(["play", "m.npz", "--meshes", str(package), "--no-meshes"]) == 2
    assert "pass only one of them" in capsys.readouterr().err
