"""Meshes that cannot be drawn leave the other shapes of a robot intact."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pinred
from pinred.views.playback.drawn_bodies import Bodies, drawn_bodies

OBJ = "v 0 0 0\nv 1 0 0\nv 0 2 0\nv 0 0 3\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
INERTIA = (
    '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    "</inertial>"
)


def write(folder: Path, *geometries: str) -> Path:
    """Write a URDF of links in a chain, each with one geometry."""
    (folder / "good.obj").write_text(OBJ)
    links = "".join(
        f'<link name="l{k}">{INERTIA}<visual><origin xyz="0 0 {k}"/><geometry>{geometry}'
        "</geometry></visual></link>"
        for k, geometry in enumerate(geometries)
    )
    joints = "".join(
        f'<joint name="j{k}" type="continuous"><parent link="l{k - 1}"/><child link="l{k}"/>'
        '<origin xyz="0 0 1"/><axis xyz="0 1 0"/></joint>'
        for k in range(1, len(geometries))
    )
    path = folder / "robot.urdf"
    path.write_text(f'<robot name="r">{links}{joints}</robot>')
    return path


def drawn(path: Path) -> Bodies:
    """Return the shapes of a robot."""
    return drawn_bodies(pinred.load(path))


def mesh(name: str = "good.obj", scale: str = "1 1 1") -> str:
    """Return a mesh element."""
    return f'<mesh filename="{name}" scale="{scale}"/>'


def test_body_of_an_unreadable_mesh_is_an_ellipsoid(tmp_path: Path) -> None:
    """The remark names the mesh and its link; meshes of one file and scale are stored once."""
    (tmp_path / "bad.obj").write_text("v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    path = write(tmp_path, mesh(), mesh("bad.obj"), mesh(), mesh(scale="1 -2 1"))
    bodies = drawn(path)
    why = "1 of its shapes cannot be drawn: mesh 'bad.obj' of link 'l1' cannot be read: "
    assert bodies.note == why + "its vertices are not finite"
    shapes = [(solid.joint, solid.kind) for solid in bodies.solids]
    assert [shape for shape in shapes if shape[0] != 2] == [(1, "mesh"), (3, "mesh"), (4, "mesh")]
    assert (2, "ellipsoid") in shapes
    first, second = bodies.meshes
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]])
    assert sorted(map(tuple, first.vertices)) == sorted(map(tuple, corners))
    flipped = corners * np.array([1.0, -2.0, 1.0])
    assert sorted(map(tuple, second.vertices)) == sorted(map(tuple, flipped))


@pytest.mark.parametrize(
    ("geometry", "why"),
    [
        (mesh(scale="1 1"), "has scale '1 1', expected three numbers"),
        (mesh(scale="1 1 nan"), "has scale '1 1 nan', expected three numbers"),
        (mesh(scale="1 1 1e300"), "has vertices farther than 1e+06 m from its origin"),
        (mesh("gone.obj"), "could not be found"),
        (mesh("http://example.org/x.stl"), "could not be found"),
        (mesh("\x7f" + "x" * 5000), "could not be found"),
        ("<mesh/>", "could not be found"),
        ('<sphere radius="1e30"/>', ""),
    ],
)
def test_shapes_that_cannot_be_drawn_are_named(geometry: str, why: str, tmp_path: Path) -> None:
    """Without another shape, all bodies are ellipsoids."""
    bodies = drawn(write(tmp_path, geometry))
    assert bodies.note.startswith("bodies drawn from their inertias: 1 of its shapes cannot be")
    assert bodies.note.endswith(why)
    assert bool(why) == ("of link 'l0'" in bodies.note)
    assert [solid.kind for solid in bodies.solids] == ["ellipsoid"]


def test_robots_without_meshes_start_no_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is paid for meshes that do not exist."""
    monkeypatch.setattr("pinred.system.urdf_shapes.subprocess.Popen", None)
    bodies = drawn(write(tmp_path, '<sphere radius="0.5"/>', '<box size="1 2 3"/>'))
    assert [solid.kind for solid in bodies.solids] == ["sphere", "box"]
    assert bodies.note == ""


def test_files_are_found_beside_the_robot_and_by_scheme(tmp_path: Path) -> None:
    """A relative name is that of a file beside the URDF file."""
    (tmp_path / "package").mkdir()
    (tmp_path / "package" / "good.obj").write_text(OBJ)
    names: tuple[str, ...] = (
        "good.obj",
        f"file://{tmp_path}/good.obj",
        "package://package/good.obj",
    )
    names += ("model://package/good.obj", str(tmp_path / "good.obj"))
    bodies = drawn(write(tmp_path, *map(mesh, names)))
    assert (bodies.note, len(bodies.solids), len(bodies.meshes)) == ("", 5, 2)


def test_robots_of_too_many_links_are_ellipsoids(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pinocchio's time for shapes is quadratic in the number of links."""
    monkeypatch.setattr("pinred.system.urdf_shapes._MOST_LINKS", 2)
    ball = '<sphere radius="0.1"/>'
    assert drawn(write(tmp_path, ball, ball)).note == ""
    note = drawn(write(tmp_path, ball, ball, ball)).note
    assert note.startswith("bodies drawn from their inertias: ")
    assert note.endswith("robot.urdf has 3 links; at most 2 are drawn")
